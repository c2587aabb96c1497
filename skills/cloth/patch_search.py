# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: patches against patches, sixteen of their primitives at a time.

All bounds are compared in the frame that moves with one of the two, along axes on which they may lie apart, so
that layers that travel together or slide past each other do not look as if they would meet everything on their
way. The geometry is that in the middle of the horizon: half of the time has to be looked ahead, and half back.

A smooth stretch of cloth cannot touch itself: a patch is not searched against itself or a neighbour when all their
normals lie in one half space (Volino & Magnenat-Thalmann 1994), so that only layers that really face each
other cost anything. In a notch cloth meets itself edge to edge, however flat it is: what has borders on both sides
of one is always searched (their test of the contour, made once, of the mesh: patches.py).
"""

from __future__ import annotations

import numpy as np
from numba import int32, njit

from skills.cloth.contact import RELEASE, edge_distance
from skills.cloth.lanes import LANES, all_lanes, least, load_lanes, lowest, most, not_above, size
from skills.cloth.patches import FAR, LEAF

__all__ = ["search_pairs"]

ROOM = (
    3 * LEAF * -(-3 * LEAF // LANES)
)  # tests that two patches may need: each edge of one with all rows of the other
# so many are put down, then made, then read: what a test says would be guessed at before it is known
TESTS = 16 * ROOM
SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
ROUNDING = 2e-5  # [m] of single precision
ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
TINY = np.float32(1e-20)  # instead of 0: for points and lines
BEYOND = np.float32(FAR)


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


@njit(nogil=True, error_model="numpy", forceinline=True)
def _boxes_near(box, h, own, near, horizon):
    """Which of row h of boxes come as near as `near` to another one with the bounds `own`: a bit for each."""
    sweep = all_lanes(horizon)
    gap = all_lanes(-BEYOND)
    for d in range(3):
        away = size(load_lanes(box, h, d) - all_lanes(own[d])) - sweep * size(
            load_lanes(box, h, d + 6) - all_lanes(own[d + 6])
        )
        gap = most(gap, away - load_lanes(box, h, d + 3) - all_lanes(own[d + 3] + near))
    return not_above(gap, all_lanes(ZERO))


@njit(nogil=True, error_model="numpy", forceinline=True)
def _points_within(geo, r, box, slab, b, near, horizon):
    """Which of row r of points come as near as `near` to the box and the slab of patch b: a bit for each."""
    g, c, sweep = b // LANES, b % LANES, all_lanes(horizon)
    x, y, z, u, v, w = (
        load_lanes(geo, r, 0),
        load_lanes(geo, r, 1),
        load_lanes(geo, r, 2),
        load_lanes(geo, r, 3),
        load_lanes(geo, r, 4),
        load_lanes(geo, r, 5),
    )
    nx, ny, nz = all_lanes(slab[b, 0]), all_lanes(slab[b, 1]), all_lanes(slab[b, 2])
    gap = size(nx * x + ny * y + nz * z - all_lanes(slab[b, 3]))
    gap = gap - sweep * size(nx * u + ny * v + nz * w - all_lanes(slab[b, 5])) - all_lanes(slab[b, 4] + near)
    gap = most(gap, _beyond(x, u, box, g, c, 0, near, sweep))
    gap = most(gap, _beyond(y, v, box, g, c, 1, near, sweep))
    gap = most(gap, _beyond(z, w, box, g, c, 2, near, sweep))
    return not_above(gap, load_lanes(geo, r, 6))


@njit(nogil=True, error_model="numpy", forceinline=True)
def _beyond(x, u, box, g, c, d, near, sweep):
    """How far places x with the speeds u are beyond a box, along axis d, within +-sweep."""
    away = size(x - all_lanes(box[g, d, c])) - sweep * size(u - all_lanes(box[g, d + 6, c]))
    return away - all_lanes(box[g, d + 3, c] + near)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _edges_within(geo, r, box, slab, b, near, horizon):
    """The same for a row of edges."""
    g, c, sweep, half = b // LANES, b % LANES, all_lanes(horizon), all_lanes(HALF)
    dx, dy, dz = half * load_lanes(geo, r, 3), half * load_lanes(geo, r, 4), half * load_lanes(geo, r, 5)
    x, y, z = load_lanes(geo, r, 0) + dx, load_lanes(geo, r, 1) + dy, load_lanes(geo, r, 2) + dz
    u, v, w = load_lanes(geo, r, 7), load_lanes(geo, r, 8), load_lanes(geo, r, 9)
    nx, ny, nz = all_lanes(slab[b, 0]), all_lanes(slab[b, 1]), all_lanes(slab[b, 2])
    gap = size(nx * x + ny * y + nz * z - all_lanes(slab[b, 3])) - size(nx * dx + ny * dy + nz * dz)
    gap = gap - sweep * size(nx * u + ny * v + nz * w - all_lanes(slab[b, 5])) - all_lanes(slab[b, 4] + near)
    gap = most(gap, _beyond(x, u, box, g, c, 0, near, sweep) - size(dx))
    gap = most(gap, _beyond(y, v, box, g, c, 1, near, sweep) - size(dy))
    gap = most(gap, _beyond(z, w, box, g, c, 2, near, sweep) - size(dz))
    return not_above(gap, load_lanes(geo, r, 11) + sweep * load_lanes(geo, r, 10))


@njit(nogil=True, error_model="numpy", forceinline=True)
def _triangles_near(geo, b, points, r, c, near, horizon):
    """Which of the triangles of patch b the point in place c of row r may come as near as `near` within +-horizon
    (by their boxes and planes): a bit for each."""
    x, y, z = all_lanes(points[r, 0, c]), all_lanes(points[r, 1, c]), all_lanes(points[r, 2, c])
    nx, ny, nz, sweep = load_lanes(geo, b, 6), load_lanes(geo, b, 7), load_lanes(geo, b, 8), all_lanes(horizon)
    du = load_lanes(geo, b, 10) - all_lanes(points[r, 3, c])
    dv = load_lanes(geo, b, 11) - all_lanes(points[r, 4, c])
    dw = load_lanes(geo, b, 12) - all_lanes(points[r, 5, c])
    gap = size(nx * x + ny * y + nz * z - load_lanes(geo, b, 9)) - sweep * size(nx * du + ny * dv + nz * dw)
    gap = most(gap, most(load_lanes(geo, b, 0) - x, x - load_lanes(geo, b, 3)) - sweep * size(du))
    gap = most(gap, most(load_lanes(geo, b, 1) - y, y - load_lanes(geo, b, 4)) - sweep * size(dv))
    gap = most(gap, most(load_lanes(geo, b, 2) - z, z - load_lanes(geo, b, 5)) - sweep * size(dw))
    return not_above(
        gap, all_lanes(near + points[r, 6, c]) + load_lanes(geo, b, 14) + sweep * load_lanes(geo, b, 13)
    )


@njit(nogil=True, error_model="numpy", forceinline=True)
def _edges_near(geo, r, c, other, near, horizon):
    """Which of the edges in row `other` the one in place c of row r may come as near as `near` within +-horizon
    (Ericson 2005, 5.1.9): a bit for each."""
    zero, one, sweep = all_lanes(ZERO), all_lanes(ONE), all_lanes(horizon)
    dx, dy, dz, a = (
        all_lanes(geo[r, 3, c]),
        all_lanes(geo[r, 4, c]),
        all_lanes(geo[r, 5, c]),
        all_lanes(geo[r, 6, c]),
    )
    bx, by, bz, e = (
        load_lanes(geo, other, 3),
        load_lanes(geo, other, 4),
        load_lanes(geo, other, 5),
        load_lanes(geo, other, 6),
    )
    rx = all_lanes(geo[r, 0, c]) - load_lanes(geo, other, 0)
    ry = all_lanes(geo[r, 1, c]) - load_lanes(geo, other, 1)
    rz = all_lanes(geo[r, 2, c]) - load_lanes(geo, other, 2)
    f = bx * rx + by * ry + bz * rz
    g = dx * rx + dy * ry + dz * rz
    h = dx * bx + dy * by + dz * bz
    s = least(most((h * f - g * e) / most(a * e - h * h, all_lanes(TINY)), zero), one)
    t = least(most((h * s + f) * load_lanes(geo, other, 12), zero), one)
    s = least(most((h * t - g) * all_lanes(geo[r, 12, c]), zero), one)
    rx, ry, rz = rx + s * dx - t * bx, ry + s * dy - t * by, rz + s * dz - t * bz
    # along the line between the closest points, d long, both lie apart by d wherever they move beside it: they are
    # within reach when d^2 <= reach d + along. No root is needed for 2 reach d <= reach^2 + d^2, which is about so
    du = all_lanes(geo[r, 7, c]) - load_lanes(geo, other, 7)
    dv = all_lanes(geo[r, 8, c]) - load_lanes(geo, other, 8)
    dw = all_lanes(geo[r, 9, c]) - load_lanes(geo, other, 9)
    along = sweep * size(rx * du + ry * dv + rz * dw)
    reach = all_lanes(near + geo[r, 11, c] + horizon * geo[r, 10, c]) + load_lanes(geo, other, 11)
    reach = reach + sweep * load_lanes(geo, other, 10)
    return not_above(rx * rx + ry * ry + rz * rz, reach * reach + along + along)


@njit(nogil=True)
def search_pairs(patches, tri, edge, thick, horizon, vt, ee):
    """All pairs with a stale patch that can come within release distance within +-horizon [s] of where the patches
    were fitted, when no corner strays from its course by more than its slack; -> counts, which may exceed the
    lists' lengths."""
    near = RELEASE * thick
    n_vt = n_ee = 0
    stale, box, hit, slab, group = patches.stale, patches.box, patches.hit, patches.slab, patches.group
    layer, smooth, smooth_start, normal = patches.layer, patches.smooth, patches.smooth_start, patches.normal
    vertex, vertex_start, vertex_geo = patches.vertex, patches.vertex_start, patches.vertex_geo
    tris, tri_geo = patches.tri, patches.tri_geo
    ridges, ridge_edge = patches.ridges, patches.ridge_edge
    edge_start, edge_geo = patches.edge_start, patches.edge_geo
    close, close_edges = np.float32(near + ROUNDING), np.float32(RELEASE * edge_distance(thick) + ROUNDING)
    ahead = np.float32(horizon)
    own = np.empty(9, np.float32)
    tests = np.empty((TESTS, 4), np.uint32)
    for a in range(len(stale)):
        if not stale[a]:
            continue
        for c in range(9):
            own[c] = box[a // LANES, c, a % LANES]
        n = _meeting(a, box, group, own, stale, layer, smooth, smooth_start, normal, close, ahead, hit)
        n_vt = _near_triangles(
            a,
            hit,
            n,
            vertex,
            vertex_start,
            vertex_geo,
            tris,
            tri_geo,
            box,
            slab,
            close,
            ahead,
            tri,
            tests,
            vt,
            n_vt,
        )
        n_ee = _near_edges(
            a, hit, n, ridges, ridge_edge, edge_start, edge_geo, box, slab, close_edges, ahead, edge, tests, ee,
            n_ee
        )  # fmt: skip
    return n_vt, n_ee


@njit(nogil=True, forceinline=True)
def _meeting(a, box, group, own, stale, layer, smooth, smooth_start, normal, near, horizon, hit):
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
                joined = False
                for k in range(smooth_start[a], smooth_start[a + 1]):
                    joined = joined or smooth[k] == b
                if joined and _smooth(normal, a, b):
                    continue
            hit[n] = b
            n += 1
    return n


@njit(nogil=True, error_model="numpy", forceinline=True)
def _near_triangles(a, hit, met, vertex, start, geo, tris, tri_geo, box, slab, near, horizon, tri, tests, vt, n):
    """Vertices of patch a that can meet triangles of patches hit[:met], and the other way round."""
    m, one, tri, room = np.uint64(0), np.uint64(1), tri.view(np.uint32), np.uint64(TESTS - ROOM)
    for turn in range(2 * met):
        b = hit[np.uint64(turn // 2)]
        p, q = (a, b) if turn % 2 == 0 else (b, a)
        again = turn % 2 == 1 and a == b
        first, end = np.uint64(start[np.uint64(p)]), np.uint64(start[np.uint64(p) + one])
        for r in range(first, first if again else end):
            points = _points_within(geo, r, box, slab, np.uint64(q), near, horizon)
            while points:
                tests[m, 0], tests[m, 1], tests[m, 2] = r, lowest(points), q
                points &= points - 1
                m += one
        if m > room or turn + 1 == 2 * met:
            for k in range(m):
                tests[k, 3] = _triangles_near(tri_geo, tests[k, 2], geo, tests[k, 0], tests[k, 1], near, horizon)
            for k in range(m):
                i, q, bits = vertex[tests[k, 0], tests[k, 1]], tests[k, 2], int32(tests[k, 3])
                while bits:
                    t = tris[q, np.uint64(lowest(bits))]
                    bits &= bits - 1
                    if min(i, t) < 0:  # an empty place: bounds that are no numbers tell nothing
                        continue
                    of = np.uint64(t)
                    if i != tri[of, 0] and i != tri[of, 1] and i != tri[of, 2]:
                        if n < len(vt):
                            vt[np.uint64(n), 0], vt[np.uint64(n), 1] = i, t
                        n += 1
            m = np.uint64(0)
    return n


@njit(nogil=True, forceinline=True)
def _filled(n, row):
    """A bit for each place of a row that is in use when n places are, from row 0 on."""
    return int32((1 << min(max(n - row * LANES, 0), LANES)) - 1)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _near_edges(a, hit, met, ridges, ridge_edge, start, geo, box, slab, near, horizon, edge, tests, ee, n):
    """Edges of patch a that can meet edges of patches hit[:met]: ridges alone."""
    m, one, room = np.uint64(0), np.uint64(1), np.uint64(TESTS - ROOM)
    own, own_rows = np.uint64(start[a]), -(-ridges[a] // LANES)
    own_end = own + np.uint64(own_rows)
    for turn in range(met):
        b = np.uint64(hit[np.uint64(turn)])
        first, rows = np.uint64(start[b]), -(-ridges[b] // LANES)
        for r in range(own_rows):
            within = _filled(ridges[a], r) & _edges_within(geo, own + np.uint64(r), box, slab, b, near, horizon)
            while within:
                c = lowest(within)
                within &= within - 1
                for other in range(rows):
                    tests[m, 0], tests[m, 1], tests[m, 2] = own + np.uint64(r), c, first + np.uint64(other)
                    tests[m, 3] = _filled(ridges[b], other)
                    m += one
        if m > room or turn + 1 == met:
            for k in range(m):
                tests[k, 3] &= _edges_near(geo, tests[k, 0], tests[k, 1], tests[k, 2], near, horizon)
            for k in range(m):
                r, c, other, bits = tests[k, 0], tests[k, 1], tests[k, 2], int32(tests[k, 3])
                e = np.uint64(ridge_edge[r, c])
                i, j = edge[e, 0], edge[e, 1]
                while bits:
                    o = np.uint64(lowest(bits))
                    bits &= bits - 1
                    f = np.uint64(ridge_edge[other, o])
                    apart = i != edge[f, 0] and i != edge[f, 1] and j != edge[f, 0] and j != edge[f, 1]
                    # two of one patch are met once
                    if apart and (other < own or other >= own_end or other > r or (other == r and o > c)):
                        if n < len(ee):
                            ee[np.uint64(n), 0], ee[np.uint64(n), 1] = min(e, f), max(e, f)
                        n += 1
            m = np.uint64(0)
    return n
