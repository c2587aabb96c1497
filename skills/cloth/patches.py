# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: patches of a few triangles, compared sixteen at a time.

Each vertex has a foreseen course, a straight line from where it was when it was last looked at; patches are
compared in the frame that moves with one of them, so that layers that travel together do not look as if they
would meet everything on their way. Only patches with a vertex that left its course (or whose course has run out,
or which has just woken) are searched again: cloth at rest costs nothing.

A smooth stretch of cloth cannot touch itself: a patch is not searched against itself or a neighbour when all their
normals lie in one half space (Volino & Magnenat-Thalmann 1994), so that only layers that really face each
other cost anything.

The geometry is kept in single precision, in rows of LANES, so that one row is a few vector instructions: a tree
of boxes tests less and takes longer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int32, njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.cloth.contact import EDGE_SHARE, RELEASE
from skills.cloth.mesh import ClothMesh

__all__ = ["Patches", "build_patches", "fit_patches", "search_pairs"]

LANES = 16
LEAF = 10  # triangles of a patch, at most: with its edges just about one row
SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
ROUNDING = 2e-5  # [m] of single precision
FAR = 1e6  # [m] where the unused places of a row are

ZERO, ONE, TINY = np.float32(0.0), np.float32(1.0), np.float32(1e-20)


class Patches(NamedTuple):
    """tri: (m, LANES) triangles of each patch, -1 where there is none; edge: (rows, LANES) likewise, of patch k
    in rows edge_start[k] to edge_start[k + 1]; vertex, vertex_start: its vertices. Each primitive belongs to one
    patch (of_tri, of_edge, of_vertex), so that a pair is met once. layer: (m,); ring, ring_start: triangles in and
    beside each patch; beside, beside_start: patches of its layer with a common vertex.

    Bounds where the vertices are foreseen: box (groups, 13, LANES), of each patch low and high corner, lowest and
    highest speed, slack; group (groups, 13) of LANES patches; normal (m, 6). place: (n, 3); tri_geo (m, 10,
    LANES): box, normal, offset; edge_geo (rows, 13, LANES): box, start, direction, squared length. stale: (m,)
    to be searched; hit: scratch."""

    layer: NDArray[np.int32]
    tri: NDArray[np.int32]
    edge: NDArray[np.int32]
    edge_start: NDArray[np.int32]
    vertex: NDArray[np.int32]
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
    normal: Array
    place: Array
    tri_geo: NDArray[np.float32]
    edge_geo: NDArray[np.float32]
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
    tri, of_tri = np.full((m, LANES), -1, np.int32), np.zeros(len(mesh.triangles), np.int32)
    for k, tris in enumerate(patches):
        tri[k, : len(tris)] = tris
        of_tri[tris] = k
    rows = [-(-len(e) // LANES) for e in edges]
    edge_start = np.concatenate([[0], np.cumsum(rows)]).astype(np.int32)
    owned, of_edge = np.full((edge_start[-1], LANES), -1, np.int32), np.zeros(len(edge), np.int32)
    for k, e in enumerate(edges):
        owned[edge_start[k] : edge_start[k + 1]].reshape(-1)[: len(e)] = e
        of_edge[e] = k
    vertex, vertex_start = _rows(vertices)
    of_vertex = np.zeros(len(mesh.rest), np.int32)
    of_vertex[vertex] = np.repeat(np.arange(m), np.diff(vertex_start))
    ring, ring_start = _rows(_rings(mesh, patches))
    beside, beside_start = _rows(_beside(mesh, patches))
    groups = -(-m // LANES)
    box = np.zeros((groups, 13, LANES), np.float32)
    box[:, :3], box[:, 3:6] = FAR, -FAR
    tri_geo = np.zeros((m, 10, LANES), np.float32)
    tri_geo[:, :3], tri_geo[:, 3:6] = FAR, -FAR
    edge_geo = np.zeros((len(owned), 13, LANES), np.float32)
    edge_geo[:, :3], edge_geo[:, 3:6], edge_geo[:, 6:9], edge_geo[:, 9:13] = FAR, -FAR, FAR, 1.0
    return Patches(
        mesh.triangle_layer[[tris[0] for tris in patches]].astype(np.int32),
        tri,
        owned,
        edge_start,
        vertex,
        vertex_start,
        ring,
        ring_start,
        beside,
        beside_start,
        of_vertex,
        of_tri,
        of_edge,
        box,
        np.zeros((groups, 13), np.float32),
        np.zeros((m, 6)),
        np.zeros((len(mesh.rest), 3)),
        tri_geo,
        edge_geo,
        np.zeros(m, np.bool_),
        np.zeros(m, np.int32),
    )


def _rows(lists: list[NDArray[np.intp]]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The lists one after the other, and their starts."""
    start = np.concatenate([[0], np.cumsum([len(k) for k in lists])]).astype(np.int32)
    return np.concatenate(lists).astype(np.int32), start


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


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fit_bounds(k, tris, tri, place, course, slack, box):
    """Where patch k is and how it moves."""
    g, c = k // LANES, k % LANES
    for d in range(3):
        lo, hi, slow, fast = FAR, -FAR, FAR, -FAR
        for a in range(LANES):
            t = tris[a]
            if t < 0:
                break
            for m in range(3):
                i = tri[t, m]
                lo, hi = min(lo, place[i, d]), max(hi, place[i, d])
                slow, fast = min(slow, course[i, d]), max(fast, course[i, d])
        box[g, d, c], box[g, d + 3, c], box[g, d + 6, c], box[g, d + 9, c] = lo, hi, slow, fast
    most = 0.0
    for a in range(LANES):
        t = tris[a]
        if t < 0:
            break
        for m in range(3):
            most = max(most, slack[tri[t, m]])
    box[g, 12, c] = most


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fit_normals(k, ring, tri, place, normal):
    for c in range(3):
        normal[k, c], normal[k, c + 3] = FAR, -FAR
    for t in ring:
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        ux, uy, uz = place[q, 0] - place[p, 0], place[q, 1] - place[p, 1], place[q, 2] - place[p, 2]
        vx, vy, vz = place[r, 0] - place[p, 0], place[r, 1] - place[p, 1], place[r, 2] - place[p, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        s = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        nx, ny, nz = nx * s, ny * s, nz * s
        normal[k, 0], normal[k, 3] = min(normal[k, 0], nx), max(normal[k, 3], nx)
        normal[k, 1], normal[k, 4] = min(normal[k, 1], ny), max(normal[k, 4], ny)
        normal[k, 2], normal[k, 5] = min(normal[k, 2], nz), max(normal[k, 5], nz)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fit_triangles(tris, tri, place, geo):
    for a in range(LANES):
        t = tris[a]
        if t < 0:
            break
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        for d in range(3):
            geo[d, a] = min(place[p, d], min(place[q, d], place[r, d]))
            geo[d + 3, a] = max(place[p, d], max(place[q, d], place[r, d]))
        ux, uy, uz = place[q, 0] - place[p, 0], place[q, 1] - place[p, 1], place[q, 2] - place[p, 2]
        vx, vy, vz = place[r, 0] - place[p, 0], place[r, 1] - place[p, 1], place[r, 2] - place[p, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        s = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        geo[6, a], geo[7, a], geo[8, a] = nx * s, ny * s, nz * s
        geo[9, a] = s * (nx * place[p, 0] + ny * place[p, 1] + nz * place[p, 2])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _fit_edges(edges, edge, place, geo):
    for a in range(LANES):
        e = edges[a]
        if e < 0:
            break
        i, j = edge[e, 0], edge[e, 1]
        length2 = 0.0
        for d in range(3):
            along = place[j, d] - place[i, d]
            geo[d, a], geo[d + 3, a] = min(place[i, d], place[j, d]), max(place[i, d], place[j, d])
            geo[d + 6, a], geo[d + 9, a] = place[i, d], along
            length2 += along * along
        geo[12, a] = length2 + 1e-30


@njit(nogil=True)
def fit_patches(patches, tri, edge, base, course, slack, born, now, span, stale, everything):
    """Geometry where the vertices are foreseen at `now`: base + (now - born) span course; patches that neither
    move nor have a stale vertex are as they were. Marks the patches with something stale."""
    place, box, marked = patches.place, patches.box, patches.stale
    for i in range(len(stale)):
        age = (now - born[i]) * span
        for c in range(3):
            place[i, c] = base[i, c] + age * course[i, c]
    for k in range(len(marked)):
        moves = everything
        marked[k] = False
        for t in patches.tri[k]:
            if t < 0:
                break
            for c in range(3):
                i = tri[t, c]
                marked[k] = marked[k] or stale[i]
                moves = moves or stale[i] or course[i, 0] != 0.0 or course[i, 1] != 0.0 or course[i, 2] != 0.0
        if not moves:
            continue
        _fit_bounds(k, patches.tri[k], tri, place, course, slack, box)
        around = patches.ring[patches.ring_start[k] : patches.ring_start[k + 1]]
        _fit_normals(k, around, tri, place, patches.normal)
        _fit_triangles(patches.tri[k], tri, place, patches.tri_geo[k])
        for row in range(patches.edge_start[k], patches.edge_start[k + 1]):
            _fit_edges(patches.edge[row], edge, place, patches.edge_geo[row])
    group = patches.group
    for g in range(len(group)):
        for c in range(13):
            low = c < 3 or 6 <= c < 9
            bound = box[g, c, 0]
            for a in range(1, LANES):
                if g * LANES + a < len(marked):
                    bound = min(bound, box[g, c, a]) if low else max(bound, box[g, c, a])
            group[g, c] = bound


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
def _boxes_near(box, own, near, horizon):
    """Which of a row of boxes, swept by their motion against another one, come near that: a bit for each.
    own: (13,) the bounds of the one."""
    x0, y0, z0, x1, y1, z1 = own[0], own[1], own[2], own[3], own[4], own[5]
    u0, v0, w0, u1, v1, w1, wide = own[6], own[7], own[8], own[9], own[10], own[11], near + own[12]
    bits = int32(0)
    for k in range(int32(LANES)):
        ax = box[0, k] + min(ZERO, horizon * (box[6, k] - u1))
        ay = box[1, k] + min(ZERO, horizon * (box[7, k] - v1))
        az = box[2, k] + min(ZERO, horizon * (box[8, k] - w1))
        bx = box[3, k] + max(ZERO, horizon * (box[9, k] - u0))
        by = box[4, k] + max(ZERO, horizon * (box[10, k] - v0))
        bz = box[5, k] + max(ZERO, horizon * (box[11, k] - w0))
        gap = max(max(ax - x1, x0 - bx), max(max(ay - y1, y0 - by), max(az - z1, z0 - bz))) - wide - box[12, k]
        bits |= int32(1) << int32(k) if gap <= ZERO else int32(0)
    return bits


@njit(nogil=True, error_model="numpy", fastmath=True)
def _triangles_near(geo, x, y, z, limit):
    """Which of a row of triangles may be near a point (by their boxes and planes): a bit for each."""
    bits = int32(0)
    for k in range(int32(LANES)):
        gap = max(
            max(max(geo[0, k] - x, x - geo[3, k]), max(geo[1, k] - y, y - geo[4, k])),
            max(geo[2, k] - z, z - geo[5, k]),
        )
        gap = max(gap, abs(geo[6, k] * x + geo[7, k] * y + geo[8, k] * z - geo[9, k]))
        bits |= int32(1) << int32(k) if gap <= limit else int32(0)
    return bits


@njit(nogil=True, error_model="numpy", fastmath=True)
def _edges_near(geo, other, c, limit):
    """Which of a row `other` of edges are no further than sqrt(limit) from the one in place c of a row (Ericson
    2005, 5.1.9): a bit for each."""
    x, y, z = geo[6, c], geo[7, c], geo[8, c]
    dx, dy, dz, a = geo[9, c], geo[10, c], geo[11, c], geo[12, c]
    bits = int32(0)
    for k in range(int32(LANES)):
        bx, by, bz, e = other[9, k], other[10, k], other[11, k], other[12, k]
        rx, ry, rz = x - other[6, k], y - other[7, k], z - other[8, k]
        f = bx * rx + by * ry + bz * rz
        g = dx * rx + dy * ry + dz * rz
        h = dx * bx + dy * by + dz * bz
        s = min(max((h * f - g * e) / max(a * e - h * h, TINY), ZERO), ONE)
        t = min(max((h * s + f) / e, ZERO), ONE)
        s = min(max((h * t - g) / a, ZERO), ONE)
        rx, ry, rz = rx + s * dx - t * bx, ry + s * dy - t * by, rz + s * dz - t * bz
        bits |= int32(1) << int32(k) if rx * rx + ry * ry + rz * rz <= limit else int32(0)
    return bits


@njit(nogil=True, error_model="numpy")
def _reach(box, a, b, horizon):
    """How far patches a and b can come towards each other, slack included."""
    g, c, h, d = a // LANES, a % LANES, b // LANES, b % LANES
    s2 = 0.0
    for m in range(3):
        s = max(abs(box[g, m + 9, c] - box[h, m + 6, d]), abs(box[h, m + 9, d] - box[g, m + 6, c]))
        s2 += s * s
    return box[g, 12, c] + box[h, 12, d] + horizon * np.sqrt(s2)


@njit(nogil=True)
def search_pairs(patches, tri, edge, thick, horizon, vt, ee):
    """All pairs with a stale patch that can come within release distance in `horizon` [s] when no vertex strays
    from its course by more than its slack; -> counts, which may exceed the lists' lengths."""
    near = RELEASE * thick
    n_vt = n_ee = 0
    stale, box, hit, place = patches.stale, patches.box, patches.hit, patches.place
    vertex, start = patches.vertex, patches.vertex_start
    bound = np.empty(6, np.float32)
    own = np.empty(13, np.float32)
    for a in range(len(stale)):
        if not stale[a]:
            continue
        for c in range(13):
            own[c] = box[a // LANES, c, a % LANES]
        met = _meeting(
            a, box, patches.group, own, stale, patches.layer, patches.beside, patches.beside_start, patches.normal,
            np.float32(near + ROUNDING), np.float32(horizon), hit
        )  # fmt: skip
        for row in range(met):
            b = hit[row]
            reach = _reach(box, a, b, horizon) + ROUNDING
            _grown_box(box, b, near + reach, bound)
            n_vt = _near_triangles(
                vertex, start[a], start[a + 1], b, place, bound, patches.tri, patches.tri_geo, near + reach, tri,
                vt, n_vt
            )  # fmt: skip
            if a != b:
                _grown_box(box, a, near + reach, bound)
                n_vt = _near_triangles(
                    vertex, start[b], start[b + 1], a, place, bound, patches.tri, patches.tri_geo, near + reach,
                    tri, vt, n_vt
                )  # fmt: skip
            reach += EDGE_SHARE * near
            _grown_box(box, b, reach, bound)
            n_ee = _near_edges(
                a, b, patches.edge, patches.edge_start, patches.edge_geo, bound, reach, edge, ee, n_ee
            )
    return n_vt, n_ee


@njit(nogil=True)
def _meeting(a, box, group, own, stale, layer, beside, beside_start, normal, near, horizon, hit):
    """Patches that patch a can meet into `hit`, but those of one smooth region with it, and those that are stale
    too and come first; -> their number."""
    m = len(stale)
    n = 0
    for h in range(len(group)):
        # all of the sixteen at once
        apart = False
        wide = near + own[12] + group[h, 12]
        for d in range(3):
            low = group[h, d] + min(ZERO, horizon * (group[h, d + 6] - own[d + 9])) - wide
            high = group[h, d + 3] + max(ZERO, horizon * (group[h, d + 9] - own[d + 6])) + wide
            apart = apart | (low > own[d + 3]) | (high < own[d])
        bits = 0 if apart else _boxes_near(box[h], own, near, horizon)
        b = h * LANES - 1
        while bits:
            b += 1
            found = bits & 1
            bits >>= 1
            if not found or b >= m or (b < a and stale[b]):
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


@njit(nogil=True)
def _grown_box(box, b, reach, bound):
    for c in range(3):
        bound[c] = box[b // LANES, c, b % LANES] - reach
        bound[c + 3] = box[b // LANES, c + 3, b % LANES] + reach


@njit(nogil=True)
def _near_triangles(vertex, first, last, b, place, bound, tris, geo, reach, tri, vt, n):
    """Vertices vertex[first:last] that can meet triangles of patch b, whose grown box is `bound`."""
    limit = np.float32(reach)
    for k in range(first, last):
        i = vertex[k]
        x, y, z = np.float32(place[i, 0]), np.float32(place[i, 1]), np.float32(place[i, 2])
        out = (x < bound[0]) | (x > bound[3]) | (y < bound[1]) | (y > bound[4]) | (z < bound[2]) | (z > bound[5])
        bits = 0 if out else _triangles_near(geo[b], x, y, z, limit)
        c = 0
        while bits:
            if not bits & 15:
                bits >>= 4
                c += 4
                continue
            t = tris[b, c]
            if bits & 1 and i != tri[t, 0] and i != tri[t, 1] and i != tri[t, 2]:
                if n < len(vt):
                    vt[n, 0], vt[n, 1] = i, t
                n += 1
            bits >>= 1
            c += 1
    return n


@njit(nogil=True)
def _near_edges(a, b, owned, start, geo, bound, reach, edge, ee, n):
    """Edges of patch a that can meet edges of patch b, whose grown box is `bound`."""
    limit = np.float32(reach * reach)
    for row in range(start[a], start[a + 1]):
        for c in range(LANES):
            e = owned[row, c]
            if e < 0:
                break
            if (geo[row, 0, c] > bound[3]) | (geo[row, 3, c] < bound[0]) | (geo[row, 1, c] > bound[4]):
                continue
            if (geo[row, 4, c] < bound[1]) | (geo[row, 2, c] > bound[5]) | (geo[row, 5, c] < bound[2]):
                continue
            i, j = edge[e, 0], edge[e, 1]
            for other in range(start[b], start[b + 1]):
                bits = _edges_near(geo[row], geo[other], c, limit)
                k = 0
                while bits:
                    if not bits & 15:
                        bits >>= 4
                        k += 4
                        continue
                    f = owned[other, k]
                    apart = i != edge[f, 0] and i != edge[f, 1] and j != edge[f, 0] and j != edge[f, 1]
                    if bits & 1 and apart and (a != b or other > row or (other == row and k > c)):
                        if n < len(ee):
                            ee[n, 0], ee[n, 1] = min(e, f), max(e, f)
                        n += 1
                    bits >>= 1
                    k += 1
    return n
