# mypy: allow-untyped-defs, allow-incomplete-defs
"""Computes geometry and bounds of the clusters along their predicted courses, for the search for pairs."""

from __future__ import annotations

import numpy as np
from numba import int32

from foldcell.skills.cloth.clusters import FAR
from foldcell.skills.cloth.contact.ridges import find_ridges
from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.f32x16 import (
    ctz,
    expect_columns,
    expect_rows,
    load_f32x16,
    permute,
    splat_f32x16,
    store_f32x16,
    vmax,
    vmin,
    vsqrt,
    where,
)
from foldcell.skills.cloth.simd.i32x16 import (
    LANES,
    load_i32x16,
    mask_greater,
    splat_i32x16,
)

WIDE = np.uint32(LANES)
ONE_ROW = np.uint64(1)
ZERO, ONE, HALF, THIRD = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(1.0 / 3.0)
# added to denominators that may be 0; FLAT belongs to the squared length of a sum of unit normals
TINY, FLAT = np.float32(1e-20), np.float32(1e-6)


@inner(error_model="numpy", fastmath=True, forceinline=True)
def _fit_box(first, last, place, course, slack, horizon, box, g, k):
    """Store the bounds of corners first to last - 1 along the axes in lane k of row g of `box`."""
    for d in range(3):
        lo, hi, slow, fast = place[d, first], place[d, first], course[d, first], course[d, first]
        for c in range(first, last):
            lo, hi = min(lo, place[d, c]), max(hi, place[d, c])
            slow, fast = min(slow, course[d, c]), max(fast, course[d, c])
        box[g, d, k], box[g, d + 6, k] = HALF * (lo + hi), HALF * (slow + fast)
        box[g, d + 3, k] = HALF * (hi - lo) + horizon * HALF * (fast - slow) + slack


@inner(error_model="numpy", fastmath=True, forceinline=True)
def _fit_normals(k, ring, start, geo, normal):
    """Store the least and the largest components of the normals of the triangles in and beside cluster k."""
    x_lo = y_lo = z_lo = ONE
    x_hi = y_hi = z_hi = -ONE
    for a in range(np.uint64(start[k]), np.uint64(start[k + 1])):
        p, i = ring[a] // WIDE, ring[a] % WIDE
        x, y, z = geo[p, 6, i], geo[p, 7, i], geo[p, 8, i]
        x_lo, y_lo, z_lo = min(x_lo, x), min(y_lo, y), min(z_lo, z)
        x_hi, y_hi, z_hi = max(x_hi, x), max(y_hi, y), max(z_hi, z)
    normal[k, 0], normal[k, 1], normal[k, 2] = x_lo, y_lo, z_lo
    normal[k, 3], normal[k, 4], normal[k, 5] = x_hi, y_hi, z_hi


@inner(error_model="numpy", fastmath=True, forceinline=True)
def _fit_slab(geo, k, first, last, place, course, slack, horizon, slab):
    """Store the mean normal of cluster k's triangles, and the bounds of corners first to last - 1 along this
    normal."""
    nx, ny, nz = TINY, ZERO, ZERO
    for a in range(LANES):
        nx, ny, nz = nx + geo[k, 6, a], ny + geo[k, 7, a], nz + geo[k, 8, a]
    s = ONE / np.sqrt(nx * nx + ny * ny + nz * nz + FLAT)
    nx, ny, nz = nx * s, ny * s, nz * s
    lo, hi, slow, fast = np.float32(FAR), np.float32(-FAR), np.float32(FAR), np.float32(-FAR)
    for c in range(first, last):
        at = nx * place[0, c] + ny * place[1, c] + nz * place[2, c]
        speed = nx * course[0, c] + ny * course[1, c] + nz * course[2, c]
        lo, hi, slow, fast = min(lo, at), max(hi, at), min(slow, speed), max(fast, speed)
    slab[k, 0], slab[k, 1], slab[k, 2], slab[k, 3], slab[k, 5] = nx, ny, nz, HALF * (lo + hi), HALF * (slow + fast)
    slab[k, 4] = HALF * (hi - lo) + horizon * HALF * (fast - slow) + slack


@inner(forceinline=True)
def _at(a, d, rows, at, later):
    """Return a register. Each lane reads one element of a[d], where a has the shape (3, n, LANES). The lane's
    value in `at`, modulo LANES, is the index of the element in its row. The row is rows[1] if the lane's bit in
    `later` is set, else rows[0]."""
    return where(later, permute(load_f32x16(a, d, rows[1]), at), permute(load_f32x16(a, d, rows[0]), at))


@inner(forceinline=True)
def _three_at(a, rows, at, later):
    """Call `_at` for each of the three coordinates."""
    return _at(a, 0, rows, at, later), _at(a, 1, rows, at, later), _at(a, 2, rows, at, later)


@inner(error_model="numpy", forceinline=True)
def _fit_speeds(k, d, p, q, r, geo):
    """Store the velocity of the triangles' middles along axis d, from the velocities p, q and r of their corners.
    Returns the squared differences between p, q, r and this velocity."""
    mean = (p + q + r) * splat_f32x16(THIRD)
    store_f32x16(geo, k, 10 + d, mean)
    p, q, r = p - mean, q - mean, r - mean
    return p * p, q * q, r * r


@inner(error_model="numpy", forceinline=True)
def _fit_triangles(k, tris, at, rows, place, course, slack, geo):
    """Store the geometry of the triangles of cluster k. Its corners are in the two `rows` of place and course, (3,
    rows, LANES) each; both are the same row if the cluster has LANES corners."""
    p, q, r = load_i32x16(at, k, 0), load_i32x16(at, k, 1), load_i32x16(at, k, 2)
    end = splat_i32x16(int32((rows[0] + ONE_ROW) * LANES - 1))
    in_p, in_q, in_r = mask_greater(p, end), mask_greater(q, end), mask_greater(r, end)
    px, py, pz = _three_at(place, rows, p, in_p)
    qx, qy, qz = _three_at(place, rows, q, in_q)
    rx, ry, rz = _three_at(place, rows, r, in_r)
    store_f32x16(geo, k, 0, vmin(px, vmin(qx, rx)))
    store_f32x16(geo, k, 1, vmin(py, vmin(qy, ry)))
    store_f32x16(geo, k, 2, vmin(pz, vmin(qz, rz)))
    store_f32x16(geo, k, 3, vmax(px, vmax(qx, rx)))
    store_f32x16(geo, k, 4, vmax(py, vmax(qy, ry)))
    store_f32x16(geo, k, 5, vmax(pz, vmax(qz, rz)))
    ux, uy, uz, vx, vy, vz = qx - px, qy - py, qz - pz, rx - px, ry - py, rz - pz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    s = splat_f32x16(ONE) / vsqrt(nx * nx + ny * ny + nz * nz + splat_f32x16(TINY))
    there, zero = mask_greater(load_i32x16(tris, 0, k), splat_i32x16(int32(-1))), splat_f32x16(ZERO)
    nx, ny, nz = where(there, nx * s, zero), where(there, ny * s, zero), where(there, nz * s, zero)
    store_f32x16(geo, k, 6, nx)
    store_f32x16(geo, k, 7, ny)
    store_f32x16(geo, k, 8, nz)
    store_f32x16(geo, k, 9, nx * px + ny * py + nz * pz)
    px, py, pz = _three_at(course, rows, p, in_p)
    qx, qy, qz = _three_at(course, rows, q, in_q)
    rx, ry, rz = _three_at(course, rows, r, in_r)
    px, qx, rx = _fit_speeds(k, 0, px, qx, rx, geo)
    py, qy, ry = _fit_speeds(k, 1, py, qy, ry, geo)
    pz, qz, rz = _fit_speeds(k, 2, pz, qz, rz, geo)
    differs = vmax(zero, vmax(px + py + pz, vmax(qx + qy + qz, rx + ry + rz)))
    store_f32x16(geo, k, 13, vsqrt(differs))
    store_f32x16(geo, k, 14, splat_f32x16(slack))


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _fit_edge(i, j, place, course, slack, geo, row, a):
    """Store the geometry of the edge between corners i and j in lane `a` of row `row` of `geo`."""
    length2 = differs = ZERO
    for d in range(3):
        along = place[d, j] - place[d, i]
        geo[row, d, a], geo[row, d + 3, a] = place[d, i], along
        geo[row, d + 7, a] = HALF * (course[d, i] + course[d, j])
        length2 += along * along
        apart = HALF * (course[d, j] - course[d, i])
        differs += apart * apart
    geo[row, 6, a], geo[row, 10, a], geo[row, 11, a] = length2 + TINY, np.sqrt(differs), slack
    geo[row, 12, a] = ONE / (length2 + TINY)


@inner(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _fit_vertices(row, vertices, at, place, course, slack, geo):
    for a in range(LANES):
        if vertices[row, a] < 0:
            break
        i = at[row, a]
        for d in range(3):
            geo[row, d, a], geo[row, d + 3, a] = place[d, i], course[d, i]
        geo[row, 6, a] = slack


@inner(error_model="numpy")
def fit_clusters(clusters, base, course, slack, born, moving, now, span, horizon, everything, flat):
    """Update the geometry of the clusters for the time `horizon` [s] after the substep `now`. The predicted
    position of a corner is base + course x time since the substep `born`, where a substep lasts `span` [s].
    Clusters that neither move nor are stale are not updated, unless `everything` is set. The bounds of normals are
    updated in stale clusters and their neighbours, because the search reads only these. The bent edges are updated
    in the clusters with new geometry and their neighbours. flat: cosine of the angle from which an edge is a ridge
    (ridges.py)."""
    place, box, corner_start, stale = clusters.place, clusters.box, clusters.corner_start, clusters.stale
    tri, tri_at, tri_geo, slab = clusters.tri, clusters.tri_at.view(np.uint32), clusters.tri_geo, clusters.slab
    edge = clusters.edge
    vertex, vertex_at, vertex_geo = clusters.vertex, clusters.vertex_at.view(np.uint32), clusters.vertex_geo
    edge_start, vertex_start, fitted = clusters.edge_start, clusters.vertex_start, clusters.fitted
    beside, beside_start = clusters.beside, clusters.beside_start
    ring, ring_start, normal = clusters.ring.view(np.uint32), clusters.ring_start, clusters.normal
    rim, bent, edge_beside = clusters.rim, clusters.bent, clusters.edge_beside.view(np.uint32)
    ahead = np.float32(horizon)
    place_rows, course_rows = place.reshape((3, -1, LANES)), course.reshape((3, -1, LANES))
    tris = tri.reshape((1, -1, LANES))
    expect_rows(box, 9)
    expect_rows(tri_geo, 15)
    expect_rows(vertex_geo, 7)
    expect_rows(tri_at, 3)
    expect_rows(edge_beside, 2)
    expect_columns(tri, LANES)
    expect_columns(edge, LANES)
    expect_columns(vertex, LANES)
    expect_columns(vertex_at, LANES)
    expect_columns(slab, 6)
    expect_columns(normal, 6)
    for k in range(len(moving)):
        fitted[k] = everything or moving[k] or stale[k]
        if not fitted[k]:
            continue
        first, last = np.uint64(corner_start[k]), np.uint64(corner_start[k + 1])
        age = np.float32((now - born[k]) * span + horizon)
        for d in range(3):
            for i in range(first, last):
                place[d, i] = base[d, i] + age * course[d, i]
        _fit_box(first, last, place, course, slack[k], ahead, box, k // LANES, k % LANES)
        rows = np.uint64(first // LANES), np.uint64(last // LANES) - ONE_ROW
        _fit_triangles(k, tris, tri_at, rows, place_rows, course_rows, slack[k], tri_geo)
        _fit_slab(tri_geo, k, first, last, place, course, slack[k], ahead, slab)
        for row in range(np.uint64(vertex_start[k]), np.uint64(vertex_start[k + 1])):
            _fit_vertices(row, vertex, vertex_at, place, course, slack[k], vertex_geo)
    for k in range(len(moving)):
        if _beside_some(beside, beside_start, stale, k):
            _fit_normals(k, ring, ring_start, tri_geo, normal)
        if _beside_some(beside, beside_start, fitted, k):
            for row in range(np.uint64(edge_start[k]), np.uint64(edge_start[k + 1])):
                bent[row] = rim[row] | find_ridges(row, edge, edge_beside, tri_geo, flat)
    _fit_groups(box, len(moving), ahead, clusters.group)


@inner(error_model="numpy")
def fit_ridges(clusters, course, slack):
    """Update the geometry of the ridges in the clusters that were fitted (`fit_clusters`) or whose ridges changed.
    The ridges of a cluster are packed in its first rows."""
    edge, edge_at, start = clusters.edge, clusters.edge_at.view(np.uint32), clusters.edge_start
    ridge, before, place, fitted = clusters.ridge, clusters.ridge_before, clusters.place, clusters.fitted
    ridges, ridge_edge, geo, corner = clusters.ridges, clusters.ridge_edge, clusters.edge_geo, clusters.corner
    expect_rows(geo, 13)
    expect_rows(ridge_edge, 3)
    expect_rows(edge_at, 2)
    expect_columns(edge, LANES)
    for k in range(len(fitted)):
        first, last = start[k], start[k + 1]
        if not (fitted[k] or _differ(first, last, ridge, before)):
            continue
        n = np.uint32(0)
        for row in range(first, last):
            before[row] = bits = ridge[row]
            while bits:
                a = ctz(bits)
                bits &= bits - 1
                if edge[row, a] < 0:
                    continue
                to, at = np.uint32(first) + n // WIDE, n % WIDE
                i, j = edge_at[row, 0, a], edge_at[row, 1, a]
                _fit_edge(i, j, place, course, slack[k], geo, to, at)
                ridge_edge[to, 0, at] = edge[row, a]
                ridge_edge[to, 1, at], ridge_edge[to, 2, at] = corner[i], corner[j]
                n += np.uint32(1)
        ridges[k] = n


@inner(forceinline=True)
def _differ(first, last, a, b):
    """Return whether two arrays differ in the rows first to last - 1."""
    found = False
    for row in range(first, last):
        found = found or a[row] != b[row]
    return found


@inner(forceinline=True)
def _beside_some(beside, start, which, k):
    """Return whether `which` is set for cluster k or a cluster beside it."""
    found = False
    for row in range(np.uint64(start[k]), np.uint64(start[k + 1])):
        found |= which[np.uint64(beside[row])]
    return found


@inner(error_model="numpy")
def _fit_groups(box, m, horizon, group):
    for g in range(len(group)):
        for d in range(3):
            lo, hi, slow, fast = np.float32(FAR), np.float32(-FAR), np.float32(FAR), np.float32(-FAR)
            for a in range(min(LANES, m - g * LANES)):
                lo, hi = min(lo, box[g, d, a] - box[g, d + 3, a]), max(hi, box[g, d, a] + box[g, d + 3, a])
                slow, fast = min(slow, box[g, d + 6, a]), max(fast, box[g, d + 6, a])
            group[g, d], group[g, d + 6] = HALF * (lo + hi), HALF * (slow + fast)
            group[g, d + 3] = HALF * (hi - lo) + horizon * HALF * (fast - slow)
