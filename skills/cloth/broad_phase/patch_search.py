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

from skills.cloth.contact.contacts import RELEASE, edge_distance
from skills.cloth.patches import FAR, LEAF
from skills.cloth.simd.f32x16 import (
    LANES,
    all_lanes,
    expect_columns,
    expect_rows,
    least,
    load_lanes,
    most,
    not_above,
    size,
)
from skills.cloth.simd.i32x16 import (
    above,
    all_whole,
    differ,
    greater,
    how_many,
    lesser,
    load_whole,
    packed,
    places,
    put_pairs,
    put_whole,
)

__all__ = ["search_pairs"]

ROOM = 3 * LEAF  # tests that two patches may need: each vertex or edge of one with the other
# so many are put down, then made: how many there are would be guessed at before it is known
TESTS = 16 * ROOM
SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
ROUNDING = 2e-5  # [m] of single precision
ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
TINY = np.float32(1e-20)  # instead of 0: for points and lines
BEYOND = np.float32(FAR)
NONE, SINGLE, TWO, WIDE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(LANES)  # for indices


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
def search_pairs(patches, thick, horizon, vt, ee):
    """All pairs with a stale patch that can come within release distance within +-horizon [s] of where the patches
    were fitted, when no corner strays from its course by more than its slack; -> counts, which exceed the lists'
    lengths if these are too short. vt, ee: (k, 2), k at least LANES: so many rows are written at once, and the
    last ones stay empty."""
    near = RELEASE * thick
    n_vt = n_ee = NONE
    stale, box, hit, slab, group = patches.stale, patches.box, patches.hit, patches.slab, patches.group
    smooth, smooth_start, normal = patches.smooth, patches.smooth_start, patches.normal
    vertex, vertex_start, vertex_geo = patches.vertex.view(np.uint32), patches.vertex_start, patches.vertex_geo
    face, tri_geo = patches.face, patches.tri_geo
    ridges, ridge_edge = patches.ridges, patches.ridge_edge
    edge_start, edge_geo = patches.edge_start, patches.edge_geo
    close, close_edges = np.float32(near + ROUNDING), np.float32(RELEASE * edge_distance(thick) + ROUNDING)
    ahead = np.float32(horizon)
    expect_rows(box, 9)
    expect_rows(tri_geo, 15)
    expect_rows(edge_geo, 13)
    expect_rows(vertex_geo, 7)
    expect_rows(face, 4)
    expect_rows(ridge_edge, 3)
    expect_columns(vertex, LANES)
    expect_columns(slab, 6)
    own = np.empty(9, np.float32)
    which, of = np.empty(TESTS + LANES, np.uint32), np.empty(TESTS + LANES, np.uint32)
    found = np.empty(3 * TESTS, np.int32)
    done, left_out = np.zeros(len(group), np.int32), np.empty(len(group), np.int32)
    for a in range(len(stale), len(group) * LANES):  # there are no such patches
        done[a // LANES] |= int32(1 << (a % LANES))
    for a in range(len(stale)):
        if not stale[a]:
            continue
        for c in range(9):
            own[c] = box[a // LANES, c, a % LANES]
        for h in range(len(group)):
            left_out[h] = done[h]
        _leave_out_smooth(a, smooth, smooth_start, normal, left_out)
        n = _meeting(box, group, own, left_out, close, ahead, hit)
        done[a // LANES] |= int32(1 << (a % LANES))
        n_vt = _near_triangles(
            a,
            hit,
            n,
            vertex,
            vertex_start,
            vertex_geo,
            face,
            tri_geo,
            box,
            slab,
            close,
            ahead,
            which,
            of,
            found,
            vt,
            n_vt,
        )
        n_ee = _near_edges(
            a, hit, n, ridges, ridge_edge, edge_start, edge_geo, box, slab, close_edges, ahead, which, of,
            found, ee, n_ee
        )  # fmt: skip
    return _counted(n_vt, vt), _counted(n_ee, ee)


@njit(nogil=True, forceinline=True)
def _counted(n, pairs):
    """n, or more than there is room for: LANES are written at once, so the last places stay empty."""
    return np.int64(n) if np.int64(n) <= len(pairs) - LANES else len(pairs) + 1


@njit(nogil=True, forceinline=True)
def _leave_out_smooth(a, smooth, start, normal, left_out):
    """Marks patches of one smooth region with patch a: a bit for each."""
    for k in range(start[a], start[a + 1]):
        b = np.uint64(smooth[k])
        left_out[b // WIDE] |= int32(_smooth(normal, np.uint64(a), b)) << int32(b % WIDE)


@njit(nogil=True, forceinline=True)
def _meeting(box, group, own, left_out, near, horizon, hit):
    """Patches that one with the bounds `own` can meet into `hit`, but those left out (a bit for each); -> their
    number."""
    n = NONE
    for h in range(len(group)):
        # all of a row at once
        apart = False
        for d in range(3):
            sweep = horizon * abs(group[h, d + 6] - own[d + 6])
            apart = apart | (abs(group[h, d] - own[d]) - sweep > group[h, d + 3] + own[d + 3] + near)
        if apart:
            continue
        bits = _boxes_near(box, h, own, near, horizon) & ~left_out[h]
        put_whole(hit, n, packed(places(int32(h * LANES)), bits))
        n += how_many(bits)
    return n


@njit(nogil=True, forceinline=True)
def _put_down(which, of, m, r, bits, b):
    """Tests from place m on: of what bits tell in row r, with patch b; -> the place behind them."""
    put_whole(which, m, packed(places(int32(r * WIDE)), bits))
    put_whole(of, m, all_whole(int32(b)))
    return m + how_many(bits)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _near_triangles(
    a, hit, met, vertex, start, geo, face, tri_geo, box, slab, near, horizon, which, of, found, vt, n
):  # fmt: skip
    """Vertices of patch a that can meet triangles of patches hit[:met], and the other way round."""
    m, room, last = NONE, np.uint64(TESTS - ROOM), np.uint64(len(vt) - LANES)
    none = all_whole(int32(-1))
    for turn in range(2 * met):
        b = np.uint64(hit[turn // TWO])
        p, q = (np.uint64(a), b) if turn % TWO == 0 else (b, np.uint64(a))
        again = turn % TWO == 1 and p == q
        first, end = np.uint64(start[p]), np.uint64(start[p + SINGLE])
        for r in range(first, first if again else end):
            m = _put_down(which, of, m, r, _points_within(geo, r, box, slab, q, near, horizon), q)
        if m > room or turn + SINGLE == TWO * met:
            for k in range(m):
                found[k] = _triangles_near(tri_geo, of[k], geo, which[k] // WIDE, which[k] % WIDE, near, horizon)
            for k in range(m):
                i, q = int32(vertex[which[k] // WIDE, which[k] % WIDE]), of[k]
                t, vertices = load_whole(face, q, 0), all_whole(i)
                # no empty places: their bounds are those of others, or no numbers
                bits = found[k] & above(t, none) & (int32(0) if i < 0 else int32(-1))
                for d in range(1, 4):
                    bits &= differ(load_whole(face, q, d), vertices)
                put_pairs(vt, min(n, last), vertices, packed(t, bits))
                n += how_many(bits)
            m = NONE
    return n


@njit(nogil=True, forceinline=True)
def _rows(n):
    """Rows that n places take."""
    return np.uint64(n + (LANES - 1)) // WIDE


@njit(nogil=True, error_model="numpy", forceinline=True)
def _near_edges(a, hit, met, ridges, ridge_edge, start, geo, box, slab, near, horizon, which, of, found, ee, n):
    """Edges of patch a that can meet edges of patches hit[:met]: ridges alone."""
    m, room, last = NONE, np.uint64(TESTS - ROOM), np.uint64(len(ee) - LANES)
    own, own_rows = np.uint64(start[a]), _rows(ridges[a])
    own_end = all_whole(int32(start[a] * LANES + ridges[a]))
    for turn in range(met):
        b = np.uint64(hit[turn])
        for k in range(own_rows if ridges[b] else NONE):
            r = own + k
            within = above(own_end, places(int32(r * WIDE))) & _edges_within(geo, r, box, slab, b, near, horizon)
            m = _put_down(which, of, m, r, within, b)
        if m > room or turn + SINGLE == met:
            made = NONE
            for k in range(m):
                r, c, first = which[k] // WIDE, which[k] % WIDE, np.uint64(start[of[k]])
                for other in range(first, first + _rows(ridges[of[k]])):
                    found[made] = _edges_near(geo, r, c, other, near, horizon)
                    made += SINGLE
            made = NONE
            for k in range(m):
                r, c, b = which[k] // WIDE, which[k] % WIDE, of[k]
                e, i, j = ridge_edge[r, 0, c], ridge_edge[r, 1, c], ridge_edge[r, 2, c]
                first, end = np.uint64(start[b]), int32(start[b] * LANES + ridges[b])
                before = int32(which[k]) if b == a else int32(-1)  # two of one patch are met once
                for other in range(first, first + _rows(ridges[b])):
                    place = places(int32(other * WIDE))
                    u, v = load_whole(ridge_edge, other, 1), load_whole(ridge_edge, other, 2)
                    bits = found[made] & above(place, all_whole(before)) & above(all_whole(end), place)
                    bits &= differ(u, all_whole(i)) & differ(u, all_whole(j))
                    bits &= differ(v, all_whole(i)) & differ(v, all_whole(j))
                    f = packed(load_whole(ridge_edge, other, 0), bits)
                    put_pairs(ee, min(n, last), lesser(all_whole(e), f), greater(all_whole(e), f))
                    n += how_many(bits)
                    made += SINGLE
            m = NONE
    return n
