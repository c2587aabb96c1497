# mypy: allow-untyped-defs, allow-incomplete-defs
"""Searches for pairs of primitives that may touch: clusters against clusters, sixteen of their primitives at a
time.

Two moving bounds are compared in the frame that moves with one of them: they cannot meet if they stay apart along
one of several axes. Layers that travel together or slide past each other are thus not paired with everything on
their path. The horizon is the time for which the pairs of a search are valid. The geometry is predicted for the
middle of the horizon, so that one half of the horizon is before this time and one half after it.

A smooth region of cloth cannot touch itself. Therefore a cluster is not searched against itself or a neighbour if
all their normals lie in one half space (Volino & Magnenat-Thalmann 1994). As a result, only layers that face each
other take time. An exception is a notch in the outline, where cloth can meet itself edge to edge even if it is
flat. Clusters with borders on the two sides of a notch are therefore always searched (the contour test of the same
paper, made once per mesh in clusters.py).
"""

from __future__ import annotations

import numpy as np
from numba import int32

from foldcell.skills.cloth.clusters import FAR, LEAF
from foldcell.skills.cloth.contact.contacts import RELEASE, edge_distance
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.f32x16 import (
    expect_columns,
    expect_rows,
    load_f32x16,
    mask_less_equal,
    splat_f32x16,
    vabs,
    vmax,
    vmin,
)
from foldcell.skills.cloth.simd.i32x16 import (
    LANES,
    compress,
    iota,
    load_i32x16,
    mask_greater,
    mask_not_equal,
    popcount,
    splat_i32x16,
    store_i32x16,
    store_interleaved,
    vmax_i32x16,
    vmin_i32x16,
)

# largest number of tests that a pair of clusters adds: one for each vertex or edge that is tested against the
# other cluster
ROOM = 3 * LEAF
# Number of tests in a batch. Tests are first collected and then evaluated, so that loop lengths are known in
# advance.
TESTS = 16 * ROOM
SMOOTH = 0.15  # in a smooth region, the components of all normals along a common direction exceed this
ROUNDING = 2e-5  # [m] added to distances for the rounding errors of single precision
ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
TINY = np.float32(1e-20)  # least denominator, which would be 0 for parallel edges and for edges without length
BEYOND = np.float32(FAR)
NONE, SINGLE, TWO, WIDE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(LANES)  # unsigned, for indices


@inner(forceinline=True)
def _smooth(normal, a, b):
    """Return whether all normals of clusters a and b lean in one direction (SMOOTH)."""
    lean = 0.0
    d2 = 0.0
    for c in range(3):
        lo, hi = min(normal[a, c], normal[b, c]), max(normal[a, c + 3], normal[b, c + 3])
        d = 0.5 * (lo + hi)
        lean += min(lo * d, hi * d)
        d2 += d * d
    return lean > SMOOTH * np.sqrt(d2)


@inner(error_model="numpy", forceinline=True)
def _boxes_near(box, h, own, near, horizon):
    """Return a mask of 16 bits: bit i is set if the box in lane i of row `h` of `box` may come within `near` [m]
    of the box `own`, (9,), at a time within +-horizon [s]."""
    sweep = splat_f32x16(horizon)
    gap = splat_f32x16(-BEYOND)
    for d in range(3):
        away = vabs(load_f32x16(box, h, d) - splat_f32x16(own[d])) - sweep * vabs(
            load_f32x16(box, h, d + 6) - splat_f32x16(own[d + 6])
        )
        gap = vmax(gap, away - load_f32x16(box, h, d + 3) - splat_f32x16(own[d + 3] + near))
    return mask_less_equal(gap, splat_f32x16(ZERO))


@inner(error_model="numpy", forceinline=True)
def _points_within(geo, r, box, slab, b, near, horizon):
    """Return a mask of 16 bits: bit i is set if the point in lane i of row `r` may come within `near` [m] of the
    box and the slab of cluster b, within +-horizon [s]."""
    g, c, sweep = b // LANES, b % LANES, splat_f32x16(horizon)
    x, y, z, u, v, w = (
        load_f32x16(geo, r, 0),
        load_f32x16(geo, r, 1),
        load_f32x16(geo, r, 2),
        load_f32x16(geo, r, 3),
        load_f32x16(geo, r, 4),
        load_f32x16(geo, r, 5),
    )
    nx, ny, nz = splat_f32x16(slab[b, 0]), splat_f32x16(slab[b, 1]), splat_f32x16(slab[b, 2])
    gap = vabs(nx * x + ny * y + nz * z - splat_f32x16(slab[b, 3]))
    gap = gap - sweep * vabs(nx * u + ny * v + nz * w - splat_f32x16(slab[b, 5])) - splat_f32x16(slab[b, 4] + near)
    gap = vmax(gap, _beyond(x, u, box, g, c, 0, near, sweep))
    gap = vmax(gap, _beyond(y, v, box, g, c, 1, near, sweep))
    gap = vmax(gap, _beyond(z, w, box, g, c, 2, near, sweep))
    return mask_less_equal(gap, load_f32x16(geo, r, 6))


@inner(error_model="numpy", forceinline=True)
def _beyond(x, u, box, g, c, d, near, sweep):
    """Return the least distances along axis d of points from the box of cluster g x LANES + c within +-sweep [s],
    minus `near` [m]. x, u: positions and speeds of the points along this axis. A negative number means that the
    point may come within `near`."""
    away = vabs(x - splat_f32x16(box[g, d, c])) - sweep * vabs(u - splat_f32x16(box[g, d + 6, c]))
    return away - splat_f32x16(box[g, d + 3, c] + near)


@inner(error_model="numpy", forceinline=True)
def _edges_within(geo, r, box, slab, b, near, horizon):
    """Return a mask of 16 bits: bit i is set if the edge in lane i of row `r` may come within `near` [m] of the
    box and the slab of cluster b, within +-horizon [s]."""
    g, c, sweep, half = b // LANES, b % LANES, splat_f32x16(horizon), splat_f32x16(HALF)
    dx, dy, dz = half * load_f32x16(geo, r, 3), half * load_f32x16(geo, r, 4), half * load_f32x16(geo, r, 5)
    x, y, z = load_f32x16(geo, r, 0) + dx, load_f32x16(geo, r, 1) + dy, load_f32x16(geo, r, 2) + dz
    u, v, w = load_f32x16(geo, r, 7), load_f32x16(geo, r, 8), load_f32x16(geo, r, 9)
    nx, ny, nz = splat_f32x16(slab[b, 0]), splat_f32x16(slab[b, 1]), splat_f32x16(slab[b, 2])
    gap = vabs(nx * x + ny * y + nz * z - splat_f32x16(slab[b, 3])) - vabs(nx * dx + ny * dy + nz * dz)
    gap = gap - sweep * vabs(nx * u + ny * v + nz * w - splat_f32x16(slab[b, 5])) - splat_f32x16(slab[b, 4] + near)
    gap = vmax(gap, _beyond(x, u, box, g, c, 0, near, sweep) - vabs(dx))
    gap = vmax(gap, _beyond(y, v, box, g, c, 1, near, sweep) - vabs(dy))
    gap = vmax(gap, _beyond(z, w, box, g, c, 2, near, sweep) - vabs(dz))
    return mask_less_equal(gap, load_f32x16(geo, r, 11) + sweep * load_f32x16(geo, r, 10))


@inner(error_model="numpy", forceinline=True)
def _triangles_near(geo, b, points, r, c, near, horizon):
    """Return a mask of 16 bits: bit i is set if the triangle in lane i of cluster b may come within `near` [m] of
    the point in lane c of row `r`, within +-horizon [s]. The boxes and the planes of the triangles are tested."""
    x, y, z = splat_f32x16(points[r, 0, c]), splat_f32x16(points[r, 1, c]), splat_f32x16(points[r, 2, c])
    nx, ny, nz, sweep = (
        load_f32x16(geo, b, 6),
        load_f32x16(geo, b, 7),
        load_f32x16(geo, b, 8),
        splat_f32x16(horizon),
    )
    du = load_f32x16(geo, b, 10) - splat_f32x16(points[r, 3, c])
    dv = load_f32x16(geo, b, 11) - splat_f32x16(points[r, 4, c])
    dw = load_f32x16(geo, b, 12) - splat_f32x16(points[r, 5, c])
    gap = vabs(nx * x + ny * y + nz * z - load_f32x16(geo, b, 9)) - sweep * vabs(nx * du + ny * dv + nz * dw)
    gap = vmax(gap, vmax(load_f32x16(geo, b, 0) - x, x - load_f32x16(geo, b, 3)) - sweep * vabs(du))
    gap = vmax(gap, vmax(load_f32x16(geo, b, 1) - y, y - load_f32x16(geo, b, 4)) - sweep * vabs(dv))
    gap = vmax(gap, vmax(load_f32x16(geo, b, 2) - z, z - load_f32x16(geo, b, 5)) - sweep * vabs(dw))
    return mask_less_equal(
        gap, splat_f32x16(near + points[r, 6, c]) + load_f32x16(geo, b, 14) + sweep * load_f32x16(geo, b, 13)
    )


@inner(error_model="numpy", forceinline=True)
def _edges_near(geo, r, c, other, near, horizon):
    """Return a mask of 16 bits: bit i is set if the edge in lane i of row `other` may come within `near` [m] of
    the edge in lane c of row `r`, within +-horizon [s] (closest points: Ericson 2005, 5.1.9)."""
    zero, one, sweep = splat_f32x16(ZERO), splat_f32x16(ONE), splat_f32x16(horizon)
    dx, dy, dz, a = (
        splat_f32x16(geo[r, 3, c]),
        splat_f32x16(geo[r, 4, c]),
        splat_f32x16(geo[r, 5, c]),
        splat_f32x16(geo[r, 6, c]),
    )
    bx, by, bz, e = (
        load_f32x16(geo, other, 3),
        load_f32x16(geo, other, 4),
        load_f32x16(geo, other, 5),
        load_f32x16(geo, other, 6),
    )
    rx = splat_f32x16(geo[r, 0, c]) - load_f32x16(geo, other, 0)
    ry = splat_f32x16(geo[r, 1, c]) - load_f32x16(geo, other, 1)
    rz = splat_f32x16(geo[r, 2, c]) - load_f32x16(geo, other, 2)
    f = bx * rx + by * ry + bz * rz
    g = dx * rx + dy * ry + dz * rz
    h = dx * bx + dy * by + dz * bz
    s = vmin(vmax((h * f - g * e) / vmax(a * e - h * h, splat_f32x16(TINY)), zero), one)
    t = vmin(vmax((h * s + f) * load_f32x16(geo, other, 12), zero), one)
    s = vmin(vmax((h * t - g) * splat_f32x16(geo[r, 12, c]), zero), one)
    rx, ry, rz = rx + s * dx - t * bx, ry + s * dy - t * by, rz + s * dz - t * bz
    # Let d be the length of the line between the closest points. Motion perpendicular to this line leaves the
    # edges at least d apart; `along` is d times the possible motion along the line. The edges can touch only if
    # d^2 <= reach d + along. Since 2 reach d <= reach^2 + d^2, they then also pass the test d^2 <= reach^2 + 2
    # along. This test needs no square root and is hardly weaker.
    du = splat_f32x16(geo[r, 7, c]) - load_f32x16(geo, other, 7)
    dv = splat_f32x16(geo[r, 8, c]) - load_f32x16(geo, other, 8)
    dw = splat_f32x16(geo[r, 9, c]) - load_f32x16(geo, other, 9)
    along = sweep * vabs(rx * du + ry * dv + rz * dw)
    reach = splat_f32x16(near + geo[r, 11, c] + horizon * geo[r, 10, c]) + load_f32x16(geo, other, 11)
    reach = reach + sweep * load_f32x16(geo, other, 10)
    return mask_less_equal(rx * rx + ry * ry + rz * rz, reach * reach + along + along)


@inner()
def search_pairs(clusters, thick, horizon, vt, ee):
    """Find all pairs of primitives, at least one of them in a stale cluster, that can come within the release
    distance in the time from -horizon to +horizon [s] around the fitted state. The result is complete provided
    that no corner strays from its course by more than its slack. Vertex-triangle pairs are written to vt and edge
    pairs to ee, (k, 2) each. Returns both numbers of pairs; a number greater than the length of its list means
    that the list is too short. k is at least LANES: every write covers LANES rows, so the last LANES rows stay
    unused."""
    near = RELEASE * thick
    n_vt = n_ee = NONE
    stale, box, hit, slab, group = clusters.stale, clusters.box, clusters.hit, clusters.slab, clusters.group
    smooth, smooth_start, normal = clusters.smooth, clusters.smooth_start, clusters.normal
    vertex, vertex_start, vertex_geo = clusters.vertex.view(np.uint32), clusters.vertex_start, clusters.vertex_geo
    face, tri_geo = clusters.face, clusters.tri_geo
    ridges, ridge_edge = clusters.ridges, clusters.ridge_edge
    edge_start, edge_geo = clusters.edge_start, clusters.edge_geo
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
    for a in range(len(stale), len(group) * LANES):  # unused lanes count as done
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


@inner(forceinline=True)
def _counted(n, pairs):
    """Return n, or a number above the length of the list if the list is too short. Every write covers LANES rows,
    so the last LANES rows stay unused."""
    return np.int64(n) if np.int64(n) <= len(pairs) - LANES else len(pairs) + 1


@inner(forceinline=True)
def _leave_out_smooth(a, smooth, start, normal, left_out):
    """Set the bits in `left_out` of the clusters that form one smooth region with cluster a."""
    for k in range(start[a], start[a + 1]):
        b = np.uint64(smooth[k])
        left_out[b // WIDE] |= int32(_smooth(normal, np.uint64(a), b)) << int32(b % WIDE)


@inner(forceinline=True)
def _meeting(box, group, own, left_out, near, horizon, hit):
    """Write to `hit` the clusters that may meet a cluster with the bounds `own`, except those whose bit in
    `left_out` is set. Returns their number."""
    n = NONE
    for h in range(len(group)):
        # test the common bounds of a whole row of boxes first
        apart = False
        for d in range(3):
            sweep = horizon * abs(group[h, d + 6] - own[d + 6])
            apart = apart | (abs(group[h, d] - own[d]) - sweep > group[h, d + 3] + own[d + 3] + near)
        if apart:
            continue
        bits = _boxes_near(box, h, own, near, horizon) & ~left_out[h]
        store_i32x16(hit, n, compress(iota(int32(h * LANES)), bits))
        n += popcount(bits)
    return n


@inner(forceinline=True)
def _put_down(which, of, m, r, bits, b):
    """For each set bit, append one test: the lane of row r (to `which`) against cluster b (to `of`), from index m
    on. Returns the index after the last test."""
    store_i32x16(which, m, compress(iota(int32(r * WIDE)), bits))
    store_i32x16(of, m, splat_i32x16(int32(b)))
    return m + popcount(bits)


@inner(error_model="numpy", forceinline=True)
def _near_triangles(
    a, hit, met, vertex, start, geo, face, tri_geo, box, slab, near, horizon, which, of, found, vt, n
):  # fmt: skip
    """Append the near pairs of vertices of cluster a with triangles of the clusters hit[:met], and of triangles of
    cluster a with vertices of these clusters. Returns the number of pairs."""
    m, room, last = NONE, np.uint64(TESTS - ROOM), np.uint64(len(vt) - LANES)
    none = splat_i32x16(int32(-1))
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
                t, vertices = load_i32x16(face, q, 0), splat_i32x16(i)
                # clear the bits of unused lanes, whose bounds are undefined
                bits = found[k] & mask_greater(t, none) & (int32(0) if i < 0 else int32(-1))
                for d in range(1, 4):
                    bits &= mask_not_equal(load_i32x16(face, q, d), vertices)
                store_interleaved(vt, min(n, last), vertices, compress(t, bits))
                n += popcount(bits)
            m = NONE
    return n


@inner(forceinline=True)
def _rows(n):
    """Return the number of rows that n lanes fill."""
    return np.uint64(n + (LANES - 1)) // WIDE


@inner(error_model="numpy", forceinline=True)
def _near_edges(a, hit, met, ridges, ridge_edge, start, geo, box, slab, near, horizon, which, of, found, ee, n):
    """Append pairs of ridges of cluster a with ridges of clusters hit[:met]. Returns the number of pairs."""
    m, room, last = NONE, np.uint64(TESTS - ROOM), np.uint64(len(ee) - LANES)
    own, own_rows = np.uint64(start[a]), _rows(ridges[a])
    own_end = splat_i32x16(int32(start[a] * LANES + ridges[a]))
    for turn in range(met):
        b = np.uint64(hit[turn])
        for k in range(own_rows if ridges[b] else NONE):
            r = own + k
            within = mask_greater(own_end, iota(int32(r * WIDE))) & _edges_within(
                geo, r, box, slab, b, near, horizon
            )
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
                before = int32(which[k]) if b == a else int32(-1)  # find a pair within one cluster once only
                for other in range(first, first + _rows(ridges[b])):
                    place = iota(int32(other * WIDE))
                    u, v = load_i32x16(ridge_edge, other, 1), load_i32x16(ridge_edge, other, 2)
                    bits = (
                        found[made]
                        & mask_greater(place, splat_i32x16(before))
                        & mask_greater(splat_i32x16(end), place)
                    )
                    bits &= mask_not_equal(u, splat_i32x16(i)) & mask_not_equal(u, splat_i32x16(j))
                    bits &= mask_not_equal(v, splat_i32x16(i)) & mask_not_equal(v, splat_i32x16(j))
                    f = compress(load_i32x16(ridge_edge, other, 0), bits)
                    store_interleaved(
                        ee, min(n, last), vmin_i32x16(splat_i32x16(e), f), vmax_i32x16(splat_i32x16(e), f)
                    )
                    n += popcount(bits)
                    made += SINGLE
            m = NONE
    return n
