# mypy: allow-untyped-defs, allow-incomplete-defs
"""Finds the edges of a cloth that pass through its triangles. A physically possible state has none."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.compiled import cached


def find_crossings(positions: Array, triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return (k, 3): the two vertices of an edge and the triangle that it passes through. Edges that share a
    vertex with the triangle are left out. positions: (n, 3), triangles: (m, 3)."""
    tri = np.asarray(triangles, dtype=np.int32)
    half = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    edge = np.unique(np.sort(half, axis=1), axis=0).astype(np.int32)
    x = np.ascontiguousarray(positions, dtype=float)
    lo = x[tri].min(axis=1)
    order = np.argsort(lo[:, 0], kind="stable").astype(np.int32)
    return _scan(x, tri, edge, order, np.ascontiguousarray(lo), np.ascontiguousarray(x[tri].max(axis=1)))


def count_crossings(positions: Array, triangles: NDArray[np.int32]) -> int:
    """Return the number of edge-triangle intersections."""
    return len(find_crossings(positions, triangles))


@cached()
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
            if crosses(x, i, j, p, q, s):
                found.append((i, j, t))
    out = np.empty((len(found), 3), np.int32)
    for k in range(len(found)):
        out[k, 0], out[k, 1], out[k, 2] = found[k]
    return out


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def crosses(x, i, j, p, q, r):
    """Return whether edge i-j passes through triangle p, q, r (Moeller & Trumbore 1997)."""
    dx, dy, dz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
    ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
    wx, wy, wz = x[i, 0] - x[p, 0], x[i, 1] - x[p, 1], x[i, 2] - x[p, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    det = nx * dx + ny * dy + nz * dz
    if abs(det) < 1e-18:
        return False
    along = -(nx * wx + ny * wy + nz * wz) / det
    if along < 0.0 or along > 1.0:
        return False
    px, py, pz = wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx
    a = -(vx * px + vy * py + vz * pz) / det
    b = (ux * px + uy * py + uz * pz) / det
    return a >= 0.0 and b >= 0.0 and a + b <= 1.0
