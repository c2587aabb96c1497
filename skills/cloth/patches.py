# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: patches of some triangles, compared sixteen at a time.

Each patch foresees a course for its corners, straight lines from where they were when it was last searched, and
is searched again when one of them left its line, or the course has run out, or a corner has just woken. Its
neighbours keep theirs, although they share corners with it: a pair of primitives is good as long as the courses of
the two patches that own them are. Cloth at rest costs nothing.

All bounds are compared in the frame that moves with one of the two, along axes on which they may lie apart, so
that layers that travel together or slide past each other do not look as if they would meet everything on their
way. The geometry is that in the middle of the horizon: half of the time has to be looked ahead, and half back.

A smooth stretch of cloth cannot touch itself: a patch is not searched against itself or a neighbour when all their
normals lie in one half space (Volino & Magnenat-Thalmann 1994), so that only layers that really face each
other cost anything.

The geometry is kept in single precision, in rows of LANES, so that one row is a few vector instructions: a tree
of boxes tests less and takes longer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import int32, njit
from numba.cpython.unsafe.numbers import trailing_zeros
from numpy.typing import NDArray

from skills.cloth.contact import EDGE_SHARE, RELEASE
from skills.cloth.mesh import ClothMesh

__all__ = ["Patches", "build_patches", "fit_patches", "search_pairs"]

LANES = 16
LEAF = 10  # triangles of a patch, at most: with its edges just about one row
SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
ROUNDING = 2e-5  # [m] of single precision
FAR = 1e6  # [m] where the unused places of a row are

lowest: Any = trailing_zeros  # place of the lowest bit; an intrinsic of numba's, which its own sets use
ZERO, ONE, HALF, THIRD = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(1.0 / 3.0)
TINY, FLAT = np.float32(1e-20), np.float32(1e-6)  # instead of 0: for points and lines, for a sum of normals


class Patches(NamedTuple):
    """corner: (corners,) vertices of the patches' triangles, of patch k from corner_start[k] to
    corner_start[k + 1], a multiple of LANES (the last one is repeated): each patch has a course of its own for
    them. tri: (m, LANES) triangles of each patch, -1 where there is none; edge: (rows, LANES) likewise, of patch k
    in rows edge_start[k] to edge_start[k + 1]; vertex, vertex_start: its vertices likewise; tri_at (m, 3, LANES),
    edge_at (rows, 2, LANES), vertex_at (rows, LANES): their corners. Each primitive belongs to one patch (of_tri,
    of_edge, of_vertex), so that a pair is met once. layer: (m,); ring, ring_start: triangles in and beside each
    patch, as patch x LANES + place in it; beside, beside_start: patches of its layer with a common vertex.

    Bounds where the corners are foreseen in the middle of the horizon, as middle, extent and speed: what is within
    the extent, in the frame that moves with this speed, all the time. box (groups, 9, LANES) along the axes, of
    each patch; group (groups, 9), of LANES patches; slab (m, 6): mean normal of a patch and bounds along it;
    normal (m, 6): bounds of the normals, up to date in stale patches and those beside them. place: (3, corners);
    tri_geo (m, 15, LANES): box, normal, offset, velocity of the middle, by how much the corners' differ from it,
    slack; edge_geo (rows, 12, LANES): start, direction, squared length, and the same of its motion; vertex_geo
    (rows, 7, LANES): place, velocity, slack. stale: (m,) to be searched; hit: scratch."""

    corner: NDArray[np.int32]
    corner_start: NDArray[np.int32]
    layer: NDArray[np.int32]
    tri: NDArray[np.int32]
    tri_at: NDArray[np.int32]
    edge: NDArray[np.int32]
    edge_at: NDArray[np.int32]
    edge_start: NDArray[np.int32]
    vertex: NDArray[np.int32]
    vertex_at: NDArray[np.int32]
    vertex_start: NDArray[np.int32]
    ring: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    beside: NDArray[np.int32]
    beside_start: NDArray[np.int32]
    of_vertex: NDArray[np.int32]
    of_tri: NDArray[np.int32]
    of_edge: NDArray[np.int32]
    box: NDArray[np.float32]
    group: NDArray[np.float32]
    slab: NDArray[np.float32]
    normal: NDArray[np.float32]
    place: NDArray[np.float32]
    tri_geo: NDArray[np.float32]
    edge_geo: NDArray[np.float32]
    vertex_geo: NDArray[np.float32]
    stale: NDArray[np.bool_]
    hit: NDArray[np.int32]


def build_patches(mesh: ClothMesh, edge: NDArray[np.int32]) -> Patches:
    """Splits of each layer along its longer side; `edge`: (e, 2) in the order that pairs refer to."""
    centre = mesh.rest[mesh.triangles].mean(axis=1)
    patches: list[NDArray[np.intp]] = []

    def split(tris: NDArray[np.intp]) -> None:
        count = -(-len(tris) // LEAF)
        if count <= 1:
            patches.append(tris)
            return
        axis = int(np.argmax(np.ptp(centre[tris], axis=0)))
        order = tris[np.argsort(centre[tris, axis], kind="stable")]
        half = len(order) * (count // 2) // count
        split(order[:half])
        split(order[half:])

    for k in np.unique(mesh.triangle_layer):
        split(np.flatnonzero(mesh.triangle_layer == k))
    m = len(patches)
    vertices, edges = _shares(mesh, edge, patches)
    tri, _, of_tri = _lanes(patches, len(mesh.triangles))
    owned, edge_start, of_edge = _lanes(edges, len(edge))
    vertex, vertex_start, of_vertex = _lanes(vertices, len(mesh.rest))
    corner, corner_start, find = _corners(mesh, patches)
    slot = np.zeros(len(of_tri), np.intp)
    slot[tri[tri >= 0]] = np.flatnonzero(tri.ravel() >= 0)
    ring, ring_start = _rows([slot[tris] for tris in _rings(mesh, patches)])
    beside, beside_start = _rows(_beside(mesh, patches))
    groups = -(-m // LANES)
    box = np.zeros((groups, 9, LANES), np.float32)
    box[:, :3] = FAR
    tri_geo = np.zeros((m, 15, LANES), np.float32)
    tri_geo[:, :3], tri_geo[:, 3:6] = FAR, -FAR
    edge_geo = np.zeros((len(owned), 12, LANES), np.float32)
    edge_geo[:, :3], edge_geo[:, 3:7] = FAR, 1.0
    vertex_geo = np.zeros((len(vertex), 7, LANES), np.float32)
    vertex_geo[:, :3] = FAR
    return Patches(
        corner,
        corner_start,
        mesh.triangle_layer[[tris[0] for tris in patches]].astype(np.int32),
        tri,
        find(of_tri[tri][..., None], mesh.triangles[tri]).transpose(0, 2, 1).copy(),
        owned,
        find(of_edge[owned][..., None], edge[owned]).transpose(0, 2, 1).copy(),
        edge_start,
        vertex,
        find(of_vertex[vertex], vertex),
        vertex_start,
        ring,
        ring_start,
        beside,
        beside_start,
        of_vertex,
        of_tri,
        of_edge,
        box,
        np.zeros((groups, 9), np.float32),
        np.zeros((m, 6), np.float32),
        np.zeros((m, 6), np.float32),
        np.zeros((3, len(corner)), np.float32),
        tri_geo,
        edge_geo,
        vertex_geo,
        np.zeros(m, np.bool_),
        np.zeros(m, np.int32),
    )


def _corners(
    mesh: ClothMesh, patches: list[NDArray[np.intp]]
) -> tuple[NDArray[np.int32], NDArray[np.int32], Callable[..., NDArray[np.int32]]]:
    """Corners of the patches and their starts, and what finds the corners of given patches at given vertices."""
    n = len(mesh.rest)
    lists = [np.unique(mesh.triangles[tris]) for tris in patches]
    padded = [np.pad(v, (0, -len(v) % LANES), mode="edge") for v in lists]
    corner, start = _rows(padded)
    number = np.full((len(patches), n), -1, np.int32)
    for k, v in enumerate(lists):
        number[k, v] = start[k] + np.arange(len(v))
    return corner, start, lambda patch, vertex: number[patch, vertex]


def _rows(lists: Sequence[NDArray[np.integer]]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The lists one after the other, and their starts."""
    start = np.concatenate([[0], np.cumsum([len(k) for k in lists])]).astype(np.int32)
    return np.concatenate(lists).astype(np.int32), start


def _lanes(
    lists: list[NDArray[np.intp]], n: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """The lists in rows of LANES, each from a row of its own on; its first row; and of which list each of n is."""
    start = np.concatenate([[0], np.cumsum([-(-len(k) // LANES) for k in lists])]).astype(np.int32)
    rows, of = np.full((start[-1], LANES), -1, np.int32), np.zeros(n, np.int32)
    for k, members in enumerate(lists):
        rows[start[k] : start[k + 1]].reshape(-1)[: len(members)] = members
        of[members] = k
    return rows, start, of


def _shares(
    mesh: ClothMesh, edge: NDArray[np.int32], patches: list[NDArray[np.intp]]
) -> tuple[list[NDArray[np.intp]], list[NDArray[np.intp]]]:
    """Vertices and edges of each patch: each with one of the patches that touch it, edges with the one that has
    fewest so far."""
    number = {(min(e), max(e)): k for k, e in enumerate(edge.tolist())}
    vertex_free = np.ones(len(mesh.rest), bool)
    vertices: list[NDArray[np.intp]] = []
    touching: dict[int, list[int]] = {}
    for k, tris in enumerate(patches):
        t = mesh.triangles[tris]
        v = np.unique(t)
        sides = np.unique(np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1), axis=0)
        for i, j in sides.tolist():
            touching.setdefault(number[i, j], []).append(k)
        vertices.append(v[vertex_free[v]].astype(np.intp))
        vertex_free[v] = False
    edges: list[list[int]] = [[] for _ in patches]
    for e in sorted(touching, key=lambda e: (len(touching[e]), touching[e][0], e)):
        edges[min(touching[e], key=lambda k: len(edges[k]))].append(e)
    return vertices, [np.array(sorted(e), np.intp) for e in edges]


def _rings(mesh: ClothMesh, patches: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """The triangles of each patch and those of its layer beside them: its edges and vertices are also theirs."""
    layer = mesh.triangle_layer
    faces: dict[tuple[int, int, int], list[int]] = {}
    for t, tri in enumerate(mesh.triangles.tolist()):
        for k in range(3):
            i, j = sorted((tri[k], tri[(k + 1) % 3]))
            faces.setdefault((i, j, int(layer[t])), []).append(t)
    ring: list[set[int]] = [set(map(int, tris)) for tris in patches]
    of = {t: k for k, tris in enumerate(ring) for t in list(tris)}
    for pair in faces.values():
        for t in pair:
            ring[of[t]].update(pair)
    return [np.array(sorted(tris), np.intp) for tris in ring]


def _beside(mesh: ClothMesh, patches: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """For each patch those of its layer with a common vertex, itself among them."""
    at: dict[tuple[int, int], set[int]] = {}
    keys = [
        {(int(mesh.triangle_layer[tris[0]]), v) for v in mesh.triangles[tris].ravel().tolist()} for tris in patches
    ]
    for k, own in enumerate(keys):
        for key in own:
            at.setdefault(key, set()).add(k)
    return [np.array(sorted(set.union(*(at[key] for key in own))), np.intp) for own in keys]


@njit(nogil=True, error_model="numpy", fastmath=True)
def _fit_box(first, last, place, course, slack, horizon, box, g, k):
    """Bounds of corners first to last along the axes."""
    for d in range(3):
        lo, hi, slow, fast = place[d, first], place[d, first], course[d, first], course[d, first]
        for c in range(first, last):
            lo, hi = min(lo, place[d, c]), max(hi, place[d, c])
            slow, fast = min(slow, course[d, c]), max(fast, course[d, c])
        box[g, d, k], box[g, d + 6, k] = HALF * (lo + hi), HALF * (slow + fast)
        box[g, d + 3, k] = HALF * (hi - lo) + horizon * HALF * (fast - slow) + slack


@njit(nogil=True)
def _fit_normals(ring, geo, normal):
    """Bounds of the normals of the triangles `ring`."""
    for c in range(3):
        lo, hi = ONE, -ONE
        for slot in ring:
            n = geo[slot // LANES, 6 + c, slot % LANES]
            lo, hi = min(lo, n), max(hi, n)
        normal[c], normal[c + 3] = lo, hi


@njit(nogil=True, error_model="numpy", fastmath=True)
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
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
    place, box, corner_start = patches.place, patches.box, patches.corner_start
    ahead = np.float32(horizon)
    for k in range(len(moving)):
        if not (everything or moving[k] or patches.stale[k]):
            continue
        first, last = corner_start[k], corner_start[k + 1]
        age = np.float32((now - born[k]) * span + horizon)
        for d in range(3):
            for i in range(first, last):
                place[d, i] = base[d, i] + age * course[d, i]
        _fit_box(first, last, place, course, slack[k], ahead, box, k // LANES, k % LANES)
        _fit_triangles(patches.tri[k], patches.tri_at[k], place, course, slack[k], patches.tri_geo[k])
        _fit_slab(patches.tri_geo, k, first, last, place, course, slack[k], ahead, patches.slab)
        for row in range(patches.edge_start[k], patches.edge_start[k + 1]):
            _fit_edges(patches.edge[row], patches.edge_at[row], place, course, slack[k], patches.edge_geo[row])
        for row in range(patches.vertex_start[k], patches.vertex_start[k + 1]):
            _fit_vertices(
                patches.vertex[row], patches.vertex_at[row], place, course, slack[k], patches.vertex_geo[row]
            )
    for k in range(len(moving)):
        if _beside_stale(patches, k):
            around = patches.ring[patches.ring_start[k] : patches.ring_start[k + 1]]
            _fit_normals(around, patches.tri_geo, patches.normal[k])
    _fit_groups(box, len(moving), ahead, patches.group)


@njit(nogil=True)
def _beside_stale(patches, k):
    """Whether patch k or one beside it is to be searched."""
    for row in range(patches.beside_start[k], patches.beside_start[k + 1]):
        if patches.stale[patches.beside[row]]:
            return True
    return False


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


@njit(nogil=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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
    stale, box, hit, slab = patches.stale, patches.box, patches.hit, patches.slab
    close, close_edges = np.float32(near + ROUNDING), np.float32(EDGE_SHARE * near + ROUNDING)
    ahead = np.float32(horizon)
    own = np.empty(9, np.float32)
    for a in range(len(stale)):
        if not stale[a]:
            continue
        for c in range(9):
            own[c] = box[a // LANES, c, a % LANES]
        n = _meeting(
            a, box, patches.group, own, stale, patches.layer, patches.beside, patches.beside_start, patches.normal,
            close, ahead, hit
        )  # fmt: skip
        n_vt = _near_triangles(
            a, hit, n, patches.vertex, patches.vertex_start, patches.vertex_geo, patches.tri, patches.tri_geo, box,
            slab, close, ahead, tri, vt, n_vt
        )  # fmt: skip
        n_ee = _near_edges(
            a, hit, n, patches.edge, patches.edge_start, patches.edge_geo, box, slab, close_edges, ahead, edge, ee,
            n_ee
        )  # fmt: skip
    return n_vt, n_ee


@njit(nogil=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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


@njit(nogil=True, error_model="numpy", fastmath=True)
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
