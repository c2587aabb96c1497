# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: a tree of boxes over the mesh, with bounds on the normals.

The tree follows the mesh (it is built once, on the flat garment); its leaves are patches of a few triangles.
Each vertex has a foreseen course, a straight line from where it was when it was last looked at; boxes are
fitted to the foreseen places, and two boxes are compared in the frame that moves with one of them, so that
layers that travel together do not look as if they would meet everything on their way. Only patches with a
vertex that left its course (or whose course has run out) are searched again: cloth at rest costs nothing.

A smooth stretch of cloth cannot touch itself: a region all of whose normals lie in one half space is not searched
against itself or its neighbours (Volino & Magnenat-Thalmann 1994), so that only layers that really face each
other cost anything.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.cloth.contact import EDGE_SHARE, RELEASE, closest_on_segments
from skills.cloth.mesh import ClothMesh

__all__ = ["Tree", "build_tree", "fit_tree", "search_pairs"]

SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
LEAF = 8  # triangles of a patch, at most
ROUNDING = 2e-5  # [m] of boxes in single precision
STACK = 4096


class Tree(NamedTuple):
    """Nodes 0..m-1 are the patches, then each inner node after its children; the root is last.

    child: (nodes, 2), -1 for patches; layer: -1 where both; flat: (nodes, 4) box in material coordinates, grown
    by half an edge; size: triangles below. tri, vertex, edge: numbers of the primitives, patch after patch
    (each once: a pair of primitives is met once), with their starts (m + 1,); ring: triangles in and beside
    each patch; beside: patches of its layer with a common vertex, ascending. of_vertex, of_tri, of_edge: the
    patch that has each. box: (nodes, 6); normal: (nodes, 6); speed: (nodes, 7) bounds, the last of the slack;
    stale: (nodes,) to be searched. place: (n, 3) foreseen; vertex_at (3, n), tri_box (6, t), edge_box (6, e):
    in the order of the patches. stack, few, some: scratch."""

    child: NDArray[np.int32]
    layer: NDArray[np.int32]
    flat: Array
    size: NDArray[np.int32]
    tri: NDArray[np.int32]
    tri_start: NDArray[np.int32]
    vertex: NDArray[np.int32]
    vertex_start: NDArray[np.int32]
    edge: NDArray[np.int32]
    edge_start: NDArray[np.int32]
    ring: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    beside: NDArray[np.int32]
    beside_start: NDArray[np.int32]
    of_vertex: NDArray[np.int32]
    of_tri: NDArray[np.int32]
    of_edge: NDArray[np.int32]
    box: Array
    normal: Array
    speed: Array
    stale: NDArray[np.bool_]
    place: Array
    vertex_at: NDArray[np.float32]
    tri_box: NDArray[np.float32]
    edge_box: NDArray[np.float32]
    stack: NDArray[np.int32]
    few: NDArray[np.float32]
    some: NDArray[np.int32]


def build_tree(mesh: ClothMesh, edge: NDArray[np.int32]) -> Tree:
    """Median splits of each layer along its longer side; `edge`: (e, 2) in the order that pairs refer to."""
    centre = mesh.rest[mesh.triangles].mean(axis=1)
    patches: list[NDArray[np.intp]] = []
    inner: list[tuple[int, int]] = []  # patches count from 0 upwards, inner nodes from -1 downwards

    def split(tris: NDArray[np.intp]) -> int:
        if len(tris) <= LEAF:
            patches.append(tris)
            return len(patches) - 1
        axis = int(np.argmax(np.ptp(centre[tris], axis=0)))
        order = tris[np.argsort(centre[tris, axis], kind="stable")]
        a, b = split(order[: len(order) // 2]), split(order[len(order) // 2 :])
        inner.append((a, b))
        return -len(inner)

    roots = [split(np.flatnonzero(mesh.triangle_layer == k)) for k in np.unique(mesh.triangle_layer)]
    top = roots[0]
    for root in roots[1:]:
        inner.append((top, root))
        top = -len(inner)
    m = len(patches)
    nodes = m + len(inner)
    child = np.full((nodes, 2), -1, np.int32)
    child[m:] = np.array([[k if k >= 0 else m - 1 - k for k in pair] for pair in inner], np.int32).reshape(-1, 2)
    grow = 0.5 * float(np.median(mesh.edge_length))
    flat, layer, size = np.zeros((nodes, 4)), np.zeros(nodes, np.int32), np.ones(nodes, np.int32)
    for k, tris in enumerate(patches):
        p = mesh.rest[mesh.triangles[tris]].reshape(-1, 2)
        flat[k] = np.hstack([p.min(axis=0) - grow, p.max(axis=0) + grow])
        layer[k], size[k] = mesh.triangle_layer[tris[0]], len(tris)
    for k in range(m, nodes):
        a, b = child[k]
        flat[k] = np.hstack([np.minimum(flat[a, :2], flat[b, :2]), np.maximum(flat[a, 2:], flat[b, 2:])])
        layer[k] = layer[a] if layer[a] == layer[b] else -1
        size[k] = size[a] + size[b]
    vertices, edges = _shares(mesh, edge, patches)
    n, t, e = len(mesh.rest), len(mesh.triangles), len(edge)
    tri, tri_start, of_tri = _rows(patches, t)
    vertex, vertex_start, of_vertex = _rows(vertices, n)
    owned, edge_start, of_edge = _rows(edges, e)
    ring, ring_start, _ = _rows(_rings(mesh, patches), 0)
    beside, beside_start, _ = _rows(_beside(mesh, patches), 0)
    longest = max(map(len, [*patches, *edges]))
    return Tree(
        child,
        layer,
        flat,
        size,
        tri,
        tri_start,
        vertex,
        vertex_start,
        owned,
        edge_start,
        ring,
        ring_start,
        beside,
        beside_start,
        of_vertex,
        of_tri,
        of_edge,
        np.zeros((nodes, 6)),
        np.zeros((nodes, 6)),
        np.zeros((nodes, 7)),
        np.zeros(nodes, np.bool_),
        np.zeros((n, 3)),
        np.zeros((3, n), np.float32),
        np.zeros((6, t), np.float32),
        np.zeros((6, e), np.float32),
        np.zeros((STACK, 2), np.int32),
        np.zeros((longest + 1, 6), np.float32),
        np.zeros(longest + 1, np.int32),
    )


def _rows(
    lists: list[NDArray[np.intp]], count: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """The lists one after the other, their starts, and for each of `count` numbers the list that has it."""
    start = np.concatenate([[0], np.cumsum([len(k) for k in lists])]).astype(np.int32)
    flat = np.concatenate(lists).astype(np.int32)
    of = np.zeros(count, np.int32)
    if count:
        of[flat] = np.repeat(np.arange(len(lists)), np.diff(start))
    return flat, start, of


def _shares(
    mesh: ClothMesh, edge: NDArray[np.int32], patches: list[NDArray[np.intp]]
) -> tuple[list[NDArray[np.intp]], list[NDArray[np.intp]]]:
    """Vertices and edges of each patch, each with the first patch that touches it."""
    number = {(min(e), max(e)): k for k, e in enumerate(edge.tolist())}
    vertex_free, edge_free = np.ones(len(mesh.rest), bool), np.ones(len(edge), bool)
    vertices, edges = [], []
    for tris in patches:
        t = mesh.triangles[tris]
        v = np.unique(t)
        sides = np.unique(np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1), axis=0)
        e = np.array([number[i, j] for i, j in sides.tolist()])
        vertices.append(v[vertex_free[v]].astype(np.intp))
        edges.append(e[edge_free[e]])
        vertex_free[v] = False
        edge_free[e] = False
    return vertices, edges


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


@njit(nogil=True)
def _fit_boxes(a0, a1, parts, index, place, out):
    """Boxes of primitives: parts (k, 2 or 3) vertices of each, index: which one each place of `out` has."""
    for a in range(a0, a1):
        t = index[a]
        for c in range(3):
            low = high = place[parts[t, 0], c]
            for m in range(1, parts.shape[1]):
                low, high = min(low, place[parts[t, m], c]), max(high, place[parts[t, m], c])
            out[c, a], out[c + 3, a] = low, high


@njit(nogil=True, fastmath={"contract"})
def _fit_patch(k, a0, a1, r0, r1, triangle, ring, tri, place, course, slack, box, speed, normal):
    """Bounds of one patch: where it is, how it moves, where it faces."""
    for c in range(3):
        box[k, c] = speed[k, c] = normal[k, c] = 1e9
        box[k, c + 3] = speed[k, c + 3] = normal[k, c + 3] = -1e9
    speed[k, 6] = 0.0
    for a in range(a0, a1):
        t = triangle[a]
        for m in range(3):
            i = tri[t, m]
            speed[k, 6] = max(speed[k, 6], slack[i])
            for c in range(3):
                box[k, c], box[k, c + 3] = min(box[k, c], place[i, c]), max(box[k, c + 3], place[i, c])
                speed[k, c], speed[k, c + 3] = min(speed[k, c], course[i, c]), max(speed[k, c + 3], course[i, c])
    for a in range(r0, r1):
        t = ring[a]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        ux, uy, uz = place[q, 0] - place[p, 0], place[q, 1] - place[p, 1], place[q, 2] - place[p, 2]
        vx, vy, vz = place[r, 0] - place[p, 0], place[r, 1] - place[p, 1], place[r, 2] - place[p, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        s = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        nx, ny, nz = nx * s, ny * s, nz * s
        normal[k, 0], normal[k, 3] = min(normal[k, 0], nx), max(normal[k, 3], nx)
        normal[k, 1], normal[k, 4] = min(normal[k, 1], ny), max(normal[k, 4], ny)
        normal[k, 2], normal[k, 5] = min(normal[k, 2], nz), max(normal[k, 5], nz)


@njit(nogil=True)
def fit_tree(tree, tri, edge, base, course, slack, born, now, span, stale, everything):
    """Boxes about where the vertices are foreseen at `now`: base + (now - born) span course; patches that neither
    move nor have a stale vertex are as they were. Marks the nodes with something stale."""
    place, box, speed, normal, marked = tree.place, tree.box, tree.speed, tree.normal, tree.stale
    triangle, tri_start, tri_box = tree.tri, tree.tri_start, tree.tri_box
    side, edge_start, edge_box = tree.edge, tree.edge_start, tree.edge_box
    vertex, vertex_start, vertex_at = tree.vertex, tree.vertex_start, tree.vertex_at
    ring, ring_start, child = tree.ring, tree.ring_start, tree.child
    m = len(tri_start) - 1
    for i in range(len(stale)):
        age = (now - born[i]) * span
        for c in range(3):
            place[i, c] = base[i, c] + age * course[i, c]
    for k in range(m):
        moves = everything
        marked[k] = everything
        for a in range(tri_start[k], tri_start[k + 1]):
            for c in range(3):
                i = tri[triangle[a], c]
                marked[k] = marked[k] or stale[i]
                moves = moves or stale[i] or course[i, 0] != 0.0 or course[i, 1] != 0.0 or course[i, 2] != 0.0
        if not moves:
            continue
        _fit_patch(
            k, tri_start[k], tri_start[k + 1], ring_start[k], ring_start[k + 1], triangle, ring, tri, place,
            course, slack, box, speed, normal
        )  # fmt: skip
        _fit_boxes(tri_start[k], tri_start[k + 1], tri, triangle, place, tri_box)
        _fit_boxes(edge_start[k], edge_start[k + 1], edge, side, place, edge_box)
        for a in range(vertex_start[k], vertex_start[k + 1]):
            for c in range(3):
                vertex_at[c, a] = place[vertex[a], c]
    for k in range(m, len(child)):
        a, b = child[k, 0], child[k, 1]
        for c in range(3):
            box[k, c], box[k, c + 3] = min(box[a, c], box[b, c]), max(box[a, c + 3], box[b, c + 3])
            normal[k, c], normal[k, c + 3] = (
                min(normal[a, c], normal[b, c]),
                max(normal[a, c + 3], normal[b, c + 3]),
            )
            speed[k, c], speed[k, c + 3] = min(speed[a, c], speed[b, c]), max(speed[a, c + 3], speed[b, c + 3])
        speed[k, 6] = max(speed[a, 6], speed[b, 6])
        marked[k] = marked[a] or marked[b]


@njit(nogil=True)
def _smooth(normal, a, b):
    """Whether all normals of nodes a and b lean towards one direction."""
    lean = 0.0
    d2 = 0.0
    for c in range(3):
        lo, hi = min(normal[a, c], normal[b, c]), max(normal[a, c + 3], normal[b, c + 3])
        d = 0.5 * (lo + hi)
        lean += min(lo * d, hi * d)
        d2 += d * d
    return lean > SMOOTH * np.sqrt(d2)


@njit(nogil=True)
def _neighbours(m, layer, f, beside, beside_start, a, b):
    """Whether two regions of one layer lie side by side in the material."""
    if layer[a] != layer[b] or layer[a] < 0:
        return False
    if a < m and b < m:
        found = False
        for k in range(beside_start[a], beside_start[a + 1]):
            found = found or beside[k] == b
        return found
    w = min(f[a, 2], f[b, 2]) - max(f[a, 0], f[b, 0])
    h = min(f[a, 3], f[b, 3]) - max(f[a, 1], f[b, 1])
    if w < 0.0 or h < 0.0:
        return False
    return w > 0.5 * min(f[a, 2] - f[a, 0], f[b, 2] - f[b, 0]) or h > 0.5 * min(
        f[a, 3] - f[a, 1], f[b, 3] - f[b, 1]
    )


@njit(nogil=True)
def _apart(box, speed, a, b, horizon, near):
    """Whether nodes a and b cannot meet: b's box, swept by its motion against a, misses a's."""
    margin = near + speed[a, 6] + speed[b, 6]
    apart = False
    for c in range(3):
        low = min(0.0, horizon * (speed[b, c] - speed[a, c + 3])) - margin
        high = max(0.0, horizon * (speed[b, c + 3] - speed[a, c])) + margin
        apart = apart | (box[b, c] + low > box[a, c + 3]) | (box[b, c + 3] + high < box[a, c])
    return apart


@njit(nogil=True)
def search_pairs(tree, met, tri, edge, course, thick, horizon, vt, ee):
    """All pairs with a stale patch that can come within release distance in `horizon` [s] when no vertex strays
    from its course by more than its slack; -> counts, which may exceed the lists' lengths, or -1 when `met`, the
    scratch, is too short. Allocates nothing."""
    near = RELEASE * thick
    place, box, speed = tree.place, tree.box, tree.speed
    # patches from the end of the scratch, their primitives from its start
    n = _meeting_patches(
        tree.child, tree.layer, tree.size, tree.flat, box, speed, tree.normal, tree.stale, tree.stack, tree.beside,
        tree.beside_start, len(tree.tri_start) - 1, horizon, near, met
    )  # fmt: skip
    if n > len(met) // 2:
        return -1, -1
    last = len(met) - n
    n_cand = _boxes_meet(
        met, last, box, speed, tree.vertex, tree.vertex_start, tree.vertex_at, tree.vertex_at, tree.tri,
        tree.tri_start, tree.tri_box, tree.few, tree.some, near, horizon, True
    )  # fmt: skip
    if n_cand < 0:
        return -1, -1
    n_vt = 0
    for c in range(n_cand):
        i, t = met[c, 0], met[c, 1]
        margin = near + speed[tree.of_vertex[i], 6] + speed[tree.of_tri[t], 6]
        if _can_meet(place, course, tri, i, t, margin, horizon):
            if n_vt < len(vt):
                vt[n_vt, 0], vt[n_vt, 1] = i, t
            n_vt += 1
    near *= EDGE_SHARE
    n_cand = _boxes_meet(
        met, last, box, speed, tree.edge, tree.edge_start, tree.edge_box[:3], tree.edge_box[3:], tree.edge,
        tree.edge_start, tree.edge_box, tree.few, tree.some, near, horizon, False
    )  # fmt: skip
    if n_cand < 0:
        return -1, -1
    n_ee = 0
    for c in range(n_cand):
        e, f = met[c, 0], met[c, 1]
        margin = near + speed[tree.of_edge[e], 6] + speed[tree.of_edge[f], 6]
        if _can_cross(place, course, edge, e, f, margin, horizon):
            if n_ee < len(ee):
                ee[n_ee, 0], ee[n_ee, 1] = min(e, f), max(e, f)
            n_ee += 1
    return n_vt, n_ee


@njit(nogil=True)
def _meeting_patches(
    child, layer, size, flat, box, speed, normal, stale, stack, beside, beside_start, m, horizon, near, met
):
    """Pairs of patches whose boxes meet and that are not parts of one smooth region, from the end of `met`; ->
    their number."""
    top, n = 1, 0
    stack[0, 0] = stack[0, 1] = len(child) - 1
    while top > 0:
        top -= 1
        a, b = stack[top, 0], stack[top, 1]
        if not (stale[a] or stale[b]):
            continue
        if a == b:
            if layer[a] >= 0 and _smooth(normal, a, a):
                continue
            if a >= m:
                c, d = child[a, 0], child[a, 1]
                stack[top, 0] = stack[top, 1] = c
                stack[top + 1, 0] = stack[top + 1, 1] = d
                stack[top + 2, 0], stack[top + 2, 1] = c, d
                top += 3
                continue
        else:
            if _apart(box, speed, a, b, horizon, near):
                continue
            if _neighbours(m, layer, flat, beside, beside_start, a, b) and _smooth(normal, a, b):
                continue
        if a < m and b < m:
            n += 1
            if n <= len(met):
                met[len(met) - n, 0], met[len(met) - n, 1] = a, b
        elif b < m or (a >= m and size[a] >= size[b]):  # open the greater of the two
            stack[top, 0], stack[top, 1] = child[a, 0], b
            stack[top + 1, 0], stack[top + 1, 1] = child[a, 1], b
            top += 2
        else:
            stack[top, 0], stack[top, 1] = a, child[b, 0]
            stack[top + 1, 0], stack[top + 1, 1] = a, child[b, 1]
            top += 2
    return n


@njit(nogil=True)
def _boxes_meet(
    met, last, box, speed, first, first_start, low, high, second, second_start, second_box, few, some, near,
    horizon, both
):  # fmt: skip
    """Primitives whose boxes meet, out of the patches from row `last` of `met` on, into the rows before; -> how
    many, or -1 when they are too many. both: each patch's first ones against the other's second ones (of another
    kind); else the two kinds are one."""
    n = 0
    for turn in range(2 * (len(met) - last)):
        row = last + (turn >> 1)
        a, b = met[row, turn & 1], met[row, 1 - (turn & 1)]
        if turn & 1 and (a == b or not both):
            continue
        margin = near + speed[a, 6] + speed[b, 6] + ROUNDING
        lx = min(0.0, horizon * (speed[b, 0] - speed[a, 3])) - margin
        ly = min(0.0, horizon * (speed[b, 1] - speed[a, 4])) - margin
        lz = min(0.0, horizon * (speed[b, 2] - speed[a, 5])) - margin
        hx = max(0.0, horizon * (speed[b, 3] - speed[a, 0])) + margin
        hy = max(0.0, horizon * (speed[b, 4] - speed[a, 1])) + margin
        hz = max(0.0, horizon * (speed[b, 5] - speed[a, 2])) + margin
        # the second ones that meet the first patch at all: swept
        x0, y0, z0, x1, y1, z1 = box[a, 0], box[a, 1], box[a, 2], box[a, 3], box[a, 4], box[a, 5]
        count = 0
        for k in range(second_start[b], second_start[b + 1]):
            bx0, by0, bz0 = second_box[0, k] + lx, second_box[1, k] + ly, second_box[2, k] + lz
            bx1, by1, bz1 = second_box[3, k] + hx, second_box[4, k] + hy, second_box[5, k] + hz
            few[count, 0], few[count, 1], few[count, 2] = bx0, by0, bz0
            few[count, 3], few[count, 4], few[count, 5] = bx1, by1, bz1
            some[count] = k
            count += (bx0 <= x1) & (bx1 >= x0) & (by0 <= y1) & (by1 >= y0) & (bz0 <= z1) & (bz1 >= z0)
        if count == 0:
            continue
        x0, y0, z0, x1, y1, z1 = (
            box[b, 0] + lx,
            box[b, 1] + ly,
            box[b, 2] + lz,
            box[b, 3] + hx,
            box[b, 4] + hy,
            box[b, 5] + hz,
        )
        for k in range(first_start[a], first_start[a + 1]):
            ax0, ay0, az0 = low[0, k], low[1, k], low[2, k]
            ax1, ay1, az1 = high[0, k], high[1, k], high[2, k]
            if (ax0 > x1) | (ax1 < x0) | (ay0 > y1) | (ay1 < y0) | (az0 > z1) | (az1 < z0):
                continue
            if n + count >= last:
                return -1
            e = first[k]
            for j in range(count):
                met[n, 0], met[n, 1] = e, second[some[j]]
                n += (
                    (few[j, 0] <= ax1)
                    & (few[j, 3] >= ax0)
                    & (few[j, 1] <= ay1)
                    & (few[j, 4] >= ay0)
                    & (few[j, 2] <= az1)
                    & (few[j, 5] >= az0)
                    & (both | (a != b) | (some[j] > k))
                )
    return n


@njit(nogil=True)
def _parting(v, i, j):
    dx, dy, dz = v[i, 0] - v[j, 0], v[i, 1] - v[j, 1], v[i, 2] - v[j, 2]
    return dx * dx + dy * dy + dz * dz


@njit(nogil=True, fastmath={"contract"})
def _can_meet(x, v, tri, i, t, near, horizon):
    p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
    if i in (p, q, r):
        return False
    reach = near + horizon * np.sqrt(max(_parting(v, i, p), max(_parting(v, i, q), _parting(v, i, r))))
    apart = False
    for c in range(3):
        lo, hi = min(x[p, c], min(x[q, c], x[r, c])), max(x[p, c], max(x[q, c], x[r, c]))
        apart = apart | (x[i, c] < lo - reach) | (x[i, c] > hi + reach)
    if apart:
        return False
    ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
    vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    d = nx * (x[i, 0] - x[p, 0]) + ny * (x[i, 1] - x[p, 1]) + nz * (x[i, 2] - x[p, 2])
    return d * d <= reach * reach * (nx * nx + ny * ny + nz * nz)


@njit(nogil=True, fastmath={"contract"})
def _can_cross(x, v, edge, e, f, near, horizon):
    i, j, k, m = edge[e, 0], edge[e, 1], edge[f, 0], edge[f, 1]
    if i in (k, m) or j in (k, m):
        return False
    speed2 = max(max(_parting(v, i, k), _parting(v, i, m)), max(_parting(v, j, k), _parting(v, j, m)))
    reach = near + horizon * np.sqrt(speed2)
    _, _, dx, dy, dz = closest_on_segments(x, i, j, k, m)
    return dx * dx + dy * dy + dz * dz <= reach * reach
