# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: patches against patches, sixteen of their primitives at a time.

All bounds are compared in the frame that moves with one of the two, along axes on which they may lie apart, so
that layers that travel together or slide past each other do not look as if they would meet everything on their
way. The geometry is that in the middle of the horizon: half of the time has to be looked ahead, and half back.

A smooth stretch of cloth cannot touch itself: a patch is not searched against itself or a neighbour when all their
normals lie in one half space (Volino & Magnenat-Thalmann 1994), so that only layers that really face each
other cost anything.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import int32, njit
from numba.cpython.unsafe.numbers import trailing_zeros

from skills.cloth.contact import EDGE_SHARE, RELEASE
from skills.cloth.patches import LANES

__all__ = ["search_pairs"]

SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
ROUNDING = 2e-5  # [m] of single precision
ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
TINY = np.float32(1e-20)  # instead of 0: for points and lines

lowest: Any = trailing_zeros  # place of the lowest bit; an intrinsic of numba's, which its own sets use


@njit(nogil=True, forceinline=True)
def _smooth(normal, a, b):
    """Whether all normals of patches a and b lean towards one direction."""
    lean = 0.0
    d2 = 0.0
    for c in range(3):
        lo, hi = min(normal[a, c], normal[b, c]), max(normal[a, c + 3], normal[b, c + 3])
        d = 0.5 * (lo + hi)
        lean += min(lo * d, hi * d)
        d2 += d * d
    return lean > SMOOTH * np.sqrt(d2)


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _boxes_near(box, h, own, near, horizon):
    """Which of row h of boxes come as near as `near` to another one with the bounds `own`: a bit for each."""
    x, y, z, u, v, w = own[0], own[1], own[2], own[6], own[7], own[8]
    a, b, c = own[3] + near, own[4] + near, own[5] + near
    bits = int32(0)
    for k in range(int32(LANES)):
        gap = abs(box[h, 0, k] - x) - horizon * abs(box[h, 6, k] - u) - box[h, 3, k] - a
        gap = max(gap, abs(box[h, 1, k] - y) - horizon * abs(box[h, 7, k] - v) - box[h, 4, k] - b)
        gap = max(gap, abs(box[h, 2, k] - z) - horizon * abs(box[h, 8, k] - w) - box[h, 5, k] - c)
        bits |= int32(1) << int32(k) if gap <= ZERO else int32(0)
    return bits


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _points_within(geo, row, box, slab, b, near, horizon):
    """Which of a row of points come as near as `near` to the box and the slab of patch b: a bit for each."""
    g, c = b // LANES, b % LANES
    cx, cy, cz, cn = box[g, 0, c], box[g, 1, c], box[g, 2, c], slab[b, 3]
    ex, ey, ez, en = box[g, 3, c] + near, box[g, 4, c] + near, box[g, 5, c] + near, slab[b, 4] + near
    ux, uy, uz, un = box[g, 6, c], box[g, 7, c], box[g, 8, c], slab[b, 5]
    nx, ny, nz = slab[b, 0], slab[b, 1], slab[b, 2]
    bits = int32(0)
    for k in range(int32(LANES)):
        x, y, z, u, v, w = (
            geo[row, 0, k],
            geo[row, 1, k],
            geo[row, 2, k],
            geo[row, 3, k],
            geo[row, 4, k],
            geo[row, 5, k],
        )
        gap = abs(nx * x + ny * y + nz * z - cn) - horizon * abs(nx * u + ny * v + nz * w - un) - en
        gap = max(gap, abs(x - cx) - horizon * abs(u - ux) - ex)
        gap = max(gap, abs(y - cy) - horizon * abs(v - uy) - ey)
        gap = max(gap, abs(z - cz) - horizon * abs(w - uz) - ez)
        bits |= int32(1) << int32(k) if gap <= geo[row, 6, k] else int32(0)
    return bits


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _edges_within(geo, row, box, slab, b, near, horizon):
    """The same for a row of edges."""
    g, c = b // LANES, b % LANES
    cx, cy, cz, cn = box[g, 0, c], box[g, 1, c], box[g, 2, c], slab[b, 3]
    ex, ey, ez, en = box[g, 3, c] + near, box[g, 4, c] + near, box[g, 5, c] + near, slab[b, 4] + near
    ux, uy, uz, un = box[g, 6, c], box[g, 7, c], box[g, 8, c], slab[b, 5]
    nx, ny, nz = slab[b, 0], slab[b, 1], slab[b, 2]
    bits = int32(0)
    for k in range(int32(LANES)):
        dx, dy, dz = HALF * geo[row, 3, k], HALF * geo[row, 4, k], HALF * geo[row, 5, k]
        x, y, z = geo[row, 0, k] + dx, geo[row, 1, k] + dy, geo[row, 2, k] + dz
        u, v, w = geo[row, 7, k], geo[row, 8, k], geo[row, 9, k]
        gap = abs(nx * x + ny * y + nz * z - cn) - horizon * abs(nx * u + ny * v + nz * w - un) - en
        gap = gap - abs(nx * dx + ny * dy + nz * dz)
        gap = max(gap, abs(x - cx) - abs(dx) - horizon * abs(u - ux) - ex)
        gap = max(gap, abs(y - cy) - abs(dy) - horizon * abs(v - uy) - ey)
        gap = max(gap, abs(z - cz) - abs(dz) - horizon * abs(w - uz) - ez)
        bits |= int32(1) << int32(k) if gap <= geo[row, 11, k] + horizon * geo[row, 10, k] else int32(0)
    return bits


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _triangles_near(geo, b, points, row, c, near, horizon):
    """Which of the triangles of patch b the point in place c of a row may come as near as `near` within +-horizon
    (by their boxes and planes): a bit for each."""
    x, y, z = points[row, 0, c], points[row, 1, c], points[row, 2, c]
    u, v, w = points[row, 3, c], points[row, 4, c], points[row, 5, c]
    near += points[row, 6, c]
    bits = int32(0)
    for k in range(int32(LANES)):
        nx, ny, nz = geo[b, 6, k], geo[b, 7, k], geo[b, 8, k]
        du, dv, dw = geo[b, 10, k] - u, geo[b, 11, k] - v, geo[b, 12, k] - w
        gap = abs(nx * x + ny * y + nz * z - geo[b, 9, k]) - horizon * abs(nx * du + ny * dv + nz * dw)
        gap = max(gap, max(geo[b, 0, k] - x, x - geo[b, 3, k]) - horizon * abs(du))
        gap = max(gap, max(geo[b, 1, k] - y, y - geo[b, 4, k]) - horizon * abs(dv))
        gap = max(gap, max(geo[b, 2, k] - z, z - geo[b, 5, k]) - horizon * abs(dw))
        bits |= int32(1) << int32(k) if gap <= near + geo[b, 14, k] + horizon * geo[b, 13, k] else int32(0)
    return bits


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _edges_near(geo, row, c, other, near, horizon):
    """Which of the edges in row `other` the one in place c of another row may come as near as `near` within
    +-horizon (Ericson 2005, 5.1.9): a bit for each."""
    near += geo[row, 11, c] + horizon * geo[row, 10, c]
    u, v, w = geo[row, 7, c], geo[row, 8, c], geo[row, 9, c]
    x, y, z = geo[row, 0, c], geo[row, 1, c], geo[row, 2, c]
    dx, dy, dz, a = geo[row, 3, c], geo[row, 4, c], geo[row, 5, c], geo[row, 6, c]
    bits = int32(0)
    for k in range(int32(LANES)):
        bx, by, bz, e = geo[other, 3, k], geo[other, 4, k], geo[other, 5, k], geo[other, 6, k]
        rx, ry, rz = x - geo[other, 0, k], y - geo[other, 1, k], z - geo[other, 2, k]
        f = bx * rx + by * ry + bz * rz
        g = dx * rx + dy * ry + dz * rz
        h = dx * bx + dy * by + dz * bz
        s = min(max((h * f - g * e) / max(a * e - h * h, TINY), ZERO), ONE)
        t = min(max((h * s + f) / e, ZERO), ONE)
        s = min(max((h * t - g) / a, ZERO), ONE)
        rx, ry, rz = rx + s * dx - t * bx, ry + s * dy - t * by, rz + s * dz - t * bz
        # along the line between the closest points both lie apart by its length, wherever they move beside it
        along = abs(rx * (geo[other, 7, k] - u) + ry * (geo[other, 8, k] - v) + rz * (geo[other, 9, k] - w))
        d2 = rx * rx + ry * ry + rz * rz
        reach = near + geo[other, 11, k] + horizon * geo[other, 10, k]
        bits |= int32(1) << int32(k) if d2 <= reach * np.sqrt(d2) + horizon * along else int32(0)
    return bits


@njit(nogil=True)
def search_pairs(patches, tri, edge, thick, horizon, vt, ee):
    """All pairs with a stale patch that can come within release distance within +-horizon [s] of where the patches
    were fitted, when no corner strays from its course by more than its slack; -> counts, which may exceed the
    lists' lengths."""
    near = RELEASE * thick
    n_vt = n_ee = 0
    stale, box, hit, slab, group = patches.stale, patches.box, patches.hit, patches.slab, patches.group
    layer, beside, beside_start, normal = patches.layer, patches.beside, patches.beside_start, patches.normal
    vertex, vertex_start, vertex_geo = patches.vertex, patches.vertex_start, patches.vertex_geo
    tris, tri_geo = patches.tri, patches.tri_geo
    owned, edge_start, edge_geo = patches.edge, patches.edge_start, patches.edge_geo
    close, close_edges = np.float32(near + ROUNDING), np.float32(EDGE_SHARE * near + ROUNDING)
    ahead = np.float32(horizon)
    own = np.empty(9, np.float32)
    for a in range(len(stale)):
        if not stale[a]:
            continue
        for c in range(9):
            own[c] = box[a // LANES, c, a % LANES]
        n = _meeting(a, box, group, own, stale, layer, beside, beside_start, normal, close, ahead, hit)
        n_vt = _near_triangles(
            a, hit, n, vertex, vertex_start, vertex_geo, tris, tri_geo, box, slab, close, ahead, tri, vt, n_vt
        )
        n_ee = _near_edges(a, hit, n, owned, edge_start, edge_geo, box, slab, close_edges, ahead, edge, ee, n_ee)
    return n_vt, n_ee


@njit(nogil=True, forceinline=True)
def _meeting(a, box, group, own, stale, layer, beside, beside_start, normal, near, horizon, hit):
    """Patches that patch a can meet into `hit`, but those of one smooth region with it, and those that are stale
    too and come first; -> their number."""
    m = len(stale)
    n = 0
    for h in range(len(group)):
        # all of a row at once
        apart = False
        for d in range(3):
            sweep = horizon * abs(group[h, d + 6] - own[d + 6])
            apart = apart | (abs(group[h, d] - own[d]) - sweep > group[h, d + 3] + own[d + 3] + near)
        bits = int32(0) if apart else _boxes_near(box, h, own, near, horizon)
        while bits:
            b = h * LANES + lowest(bits)
            bits &= bits - 1
            if b >= m or (b < a and stale[b]):
                continue
            if layer[a] == layer[b]:
                adjacent = False
                for k in range(beside_start[a], beside_start[a + 1]):
                    adjacent = adjacent or beside[k] == b
                if adjacent and _smooth(normal, a, b):
                    continue
            hit[n] = b
            n += 1
    return n


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _near_triangles(a, hit, met, vertex, start, geo, tris, tri_geo, box, slab, near, horizon, tri, vt, n):
    """Vertices of patch a that can meet triangles of patches hit[:met], and the other way round."""
    for turn in range(2 * met):
        b = hit[turn // 2]
        if turn % 2 == 1 and a == b:
            continue
        p, q = (a, b) if turn % 2 == 0 else (b, a)
        for row in range(start[p], start[p + 1]):
            points = _points_within(geo, row, box, slab, q, near, horizon)
            while points:
                c = lowest(points)
                points &= points - 1
                i = vertex[row, c]
                bits = _triangles_near(tri_geo, q, geo, row, c, near, horizon)
                while bits:
                    t = tris[q, lowest(bits)]
                    bits &= bits - 1
                    if i != tri[t, 0] and i != tri[t, 1] and i != tri[t, 2]:
                        if n < len(vt):
                            vt[n, 0], vt[n, 1] = i, t
                        n += 1
    return n


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _near_edges(a, hit, met, owned, start, geo, box, slab, near, horizon, edge, ee, n):
    """Edges of patch a that can meet edges of patches hit[:met]."""
    for turn in range(met):
        b = hit[turn]
        for row in range(start[a], start[a + 1]):
            within = _edges_within(geo, row, box, slab, b, near, horizon)
            while within:
                c = lowest(within)
                within &= within - 1
                e = owned[row, c]
                i, j = edge[e, 0], edge[e, 1]
                for other in range(start[b], start[b + 1]):
                    bits = _edges_near(geo, row, c, other, near, horizon)
                    while bits:
                        k = lowest(bits)
                        bits &= bits - 1
                        f = owned[other, k]
                        apart = i != edge[f, 0] and i != edge[f, 1] and j != edge[f, 0] and j != edge[f, 1]
                        if apart and (a != b or other > row or (other == row and k > c)):
                            if n < len(ee):
                                ee[n, 0], ee[n, 1] = min(e, f), max(e, f)
                            n += 1
    return n
