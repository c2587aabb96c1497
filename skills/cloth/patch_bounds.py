# mypy: allow-untyped-defs, allow-incomplete-defs
"""The geometry of patches where their courses lead, and what bounds it for the search."""

from __future__ import annotations

import numpy as np
from numba import njit

from skills.cloth.patches import FAR, LANES

__all__ = ["fit_patches"]

ZERO, ONE, HALF, THIRD = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(1.0 / 3.0)
TINY, FLAT = np.float32(1e-20), np.float32(1e-6)  # instead of 0: for points and lines, for a sum of normals


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _fit_box(first, last, place, course, slack, horizon, box, g, k):
    """Bounds of corners first to last along the axes."""
    for d in range(3):
        lo, hi, slow, fast = place[d, first], place[d, first], course[d, first], course[d, first]
        for c in range(first, last):
            lo, hi = min(lo, place[d, c]), max(hi, place[d, c])
            slow, fast = min(slow, course[d, c]), max(fast, course[d, c])
        box[g, d, k], box[g, d + 6, k] = HALF * (lo + hi), HALF * (slow + fast)
        box[g, d + 3, k] = HALF * (hi - lo) + horizon * HALF * (fast - slow) + slack


@njit(nogil=True, forceinline=True)
def _fit_normals(ring, geo, normal):
    """Bounds of the normals of the triangles `ring`."""
    for c in range(3):
        lo, hi = ONE, -ONE
        for slot in ring:
            n = geo[slot // LANES, 6 + c, slot % LANES]
            lo, hi = min(lo, n), max(hi, n)
        normal[c], normal[c + 3] = lo, hi


@njit(nogil=True, error_model="numpy", fastmath=True, forceinline=True)
def _fit_slab(geo, k, first, last, place, course, slack, horizon, slab):
    """Mean normal of patch k's triangles, and bounds along it."""
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _fit_triangles(tris, at, place, course, slack, geo):
    for a in range(LANES):
        if tris[a] < 0:
            break
        p, q, r = at[0, a], at[1, a], at[2, a]
        for d in range(3):
            geo[d, a] = min(place[d, p], min(place[d, q], place[d, r]))
            geo[d + 3, a] = max(place[d, p], max(place[d, q], place[d, r]))
            geo[10 + d, a] = (course[d, p] + course[d, q] + course[d, r]) * THIRD
        ux, uy, uz = place[0, q] - place[0, p], place[1, q] - place[1, p], place[2, q] - place[2, p]
        vx, vy, vz = place[0, r] - place[0, p], place[1, r] - place[1, p], place[2, r] - place[2, p]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        s = ONE / np.sqrt(nx * nx + ny * ny + nz * nz + TINY)
        nx, ny, nz = nx * s, ny * s, nz * s
        geo[6, a], geo[7, a], geo[8, a] = nx, ny, nz
        geo[9, a] = nx * place[0, p] + ny * place[1, p] + nz * place[2, p]
        most = ZERO
        for m in range(3):
            differs = ZERO
            for d in range(3):
                differs += (course[d, at[m, a]] - geo[10 + d, a]) ** 2
            most = max(most, differs)
        geo[13, a], geo[14, a] = np.sqrt(most), slack


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _fit_edges(edges, at, place, course, slack, geo):
    for a in range(LANES):
        if edges[a] < 0:
            break
        i, j = at[0, a], at[1, a]
        length2 = differs = ZERO
        for d in range(3):
            along = place[d, j] - place[d, i]
            geo[d, a], geo[d + 3, a] = place[d, i], along
            geo[d + 7, a] = HALF * (course[d, i] + course[d, j])
            length2 += along * along
            differs += (HALF * (course[d, j] - course[d, i])) ** 2
        geo[6, a], geo[10, a], geo[11, a] = length2 + TINY, np.sqrt(differs), slack


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, forceinline=True)
def _fit_vertices(vertices, at, place, course, slack, geo):
    for a in range(LANES):
        if vertices[a] < 0:
            break
        for d in range(3):
            geo[d, a], geo[d + 3, a] = place[d, at[a]], course[d, at[a]]
        geo[6, a] = slack


@njit(nogil=True, error_model="numpy")
def fit_patches(patches, base, course, slack, born, moving, now, span, horizon, everything):
    """Geometry where the corners are foreseen `horizon` [s] after the substep `now`: base + course x time since
    the substep `born`, each of `span` [s]; patches that neither move nor are stale are as they were. Normals of
    stale patches and of those beside them: no others are asked for."""
    place, box, corner_start, stale = patches.place, patches.box, patches.corner_start, patches.stale
    tri, tri_at, tri_geo, slab = patches.tri, patches.tri_at, patches.tri_geo, patches.slab
    edge, edge_at, edge_start, edge_geo = patches.edge, patches.edge_at, patches.edge_start, patches.edge_geo
    vertex, vertex_at, vertex_start = patches.vertex, patches.vertex_at, patches.vertex_start
    vertex_geo, beside, beside_start = patches.vertex_geo, patches.beside, patches.beside_start
    ahead = np.float32(horizon)
    for k in range(len(moving)):
        if not (everything or moving[k] or stale[k]):
            continue
        first, last = corner_start[k], corner_start[k + 1]
        age = np.float32((now - born[k]) * span + horizon)
        for d in range(3):
            for i in range(first, last):
                place[d, i] = base[d, i] + age * course[d, i]
        _fit_box(first, last, place, course, slack[k], ahead, box, k // LANES, k % LANES)
        _fit_triangles(tri[k], tri_at[k], place, course, slack[k], tri_geo[k])
        _fit_slab(tri_geo, k, first, last, place, course, slack[k], ahead, slab)
        for row in range(edge_start[k], edge_start[k + 1]):
            _fit_edges(edge[row], edge_at[row], place, course, slack[k], edge_geo[row])
        for row in range(vertex_start[k], vertex_start[k + 1]):
            _fit_vertices(vertex[row], vertex_at[row], place, course, slack[k], vertex_geo[row])
    for k in range(len(moving)):
        if _beside_stale(beside, beside_start, stale, k):
            around = patches.ring[patches.ring_start[k] : patches.ring_start[k + 1]]
            _fit_normals(around, tri_geo, patches.normal[k])
    _fit_groups(box, len(moving), ahead, patches.group)


@njit(nogil=True, forceinline=True)
def _beside_stale(beside, beside_start, stale, k):
    """Whether patch k or one beside it is to be searched."""
    found = False
    for row in range(beside_start[k], beside_start[k + 1]):
        found = found or stale[beside[row]]
    return found


@njit(nogil=True, error_model="numpy")
def _fit_groups(box, m, horizon, group):
    for g in range(len(group)):
        for d in range(3):
            lo, hi, slow, fast = np.float32(FAR), np.float32(-FAR), np.float32(FAR), np.float32(-FAR)
            for a in range(min(LANES, m - g * LANES)):
                lo, hi = min(lo, box[g, d, a] - box[g, d + 3, a]), max(hi, box[g, d, a] + box[g, d + 3, a])
                slow, fast = min(slow, box[g, d + 6, a]), max(fast, box[g, d + 6, a])
            group[g, d], group[g, d + 6] = HALF * (lo + hi), HALF * (slow + fast)
            group[g, d + 3] = HALF * (hi - lo) + horizon * HALF * (fast - slow)
