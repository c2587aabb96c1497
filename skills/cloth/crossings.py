# mypy: allow-untyped-defs, allow-incomplete-defs
"""How many edges of a cloth pass through its triangles: zero for cloth that is possible."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array

__all__ = ["count_crossings", "find_crossings"]


def find_crossings(positions: Array, triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """(k, 3): edge's two vertices and the triangle that it passes through; neighbours (a common vertex) are
    left out. positions: (n, 3), triangles: (m, 3)."""
    tri = np.asarray(triangles, dtype=np.int32)
    half = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    edge = np.unique(np.sort(half, axis=1), axis=0).astype(np.int32)
    x = np.ascontiguousarray(positions, dtype=float)
    lo = x[tri].min(axis=1)
    order = np.argsort(lo[:, 0], kind="stable").astype(np.int32)
    return _scan(x, tri, edge, order, np.ascontiguousarray(lo), np.ascontiguousarray(x[tri].max(axis=1)))


def count_crossings(positions: Array, triangles: NDArray[np.int32]) -> int:
    """Number of edge-triangle intersections."""
    return len(find_crossings(positions, triangles))


@njit(cache=True, nogil=True)
def _scan(x, tri, edge, order, lo, hi):
    widest = 0.0
    for t in range(len(tri)):
        widest = max(widest, hi[t, 0] - lo[t, 0])
    first = np.empty(len(tri))
    for r in range(len(tri)):
        first[r] = lo[order[r], 0]
    found = [(0, 0, 0)]
    found.pop()
    for e in range(len(edge)):
        i, j = edge[e, 0], edge[e, 1]
        a, b = min(x[i, 0], x[j, 0]), max(x[i, 0], x[j, 0])
        r = np.searchsorted(first, a - widest)
        while r < len(tri) and first[r] <= b:
            t = order[r]
            r += 1
            if hi[t, 0] < a:
                continue
            if min(x[i, 1], x[j, 1]) > hi[t, 1] or max(x[i, 1], x[j, 1]) < lo[t, 1]:
                continue
            if min(x[i, 2], x[j, 2]) > hi[t, 2] or max(x[i, 2], x[j, 2]) < lo[t, 2]:
                continue
            p, q, s = tri[t, 0], tri[t, 1], tri[t, 2]
            if i in (p, q, s) or j in (p, q, s):
                continue
            if _meets(x[i], x[j], x[p], x[q], x[s]):
                found.append((i, j, t))
    out = np.empty((len(found), 3), np.int32)
    for k in range(len(found)):
        out[k, 0], out[k, 1], out[k, 2] = found[k]
    return out


@njit(cache=True, nogil=True)
def _meets(a, b, p, q, r):
    """Segment a-b against triangle p, q, r (Moeller & Trumbore 1997)."""
    d, u, v, w = b - a, q - p, r - p, a - p
    h = np.array([d[1] * v[2] - d[2] * v[1], d[2] * v[0] - d[0] * v[2], d[0] * v[1] - d[1] * v[0]])
    det = u[0] * h[0] + u[1] * h[1] + u[2] * h[2]
    if abs(det) < 1e-18:
        return False
    s = (w[0] * h[0] + w[1] * h[1] + w[2] * h[2]) / det
    if s < 0.0 or s > 1.0:
        return False
    k = np.array([w[1] * u[2] - w[2] * u[1], w[2] * u[0] - w[0] * u[2], w[0] * u[1] - w[1] * u[0]])
    t = (d[0] * k[0] + d[1] * k[1] + d[2] * k[2]) / det
    if t < 0.0 or s + t > 1.0:
        return False
    z = (v[0] * k[0] + v[1] * k[1] + v[2] * k[2]) / det
    return 0.0 <= z <= 1.0
