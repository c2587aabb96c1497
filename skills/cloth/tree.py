# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: a tree of boxes over the mesh, with bounds on the normals.

The tree follows the mesh (it is built once, on the flat garment). Each vertex has a foreseen course, a straight line from where it was when it was last looked at; boxes are fitted
to the foreseen places, and two boxes are compared in the frame that moves with one of them, so that layers that
travel together do not look as if they would meet everything on their way. Only triangles with a vertex that left
its course (or whose course has run out) are searched again: cloth at rest costs nothing.

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
STACK = 4096


class Tree(NamedTuple):
    """Nodes 0..m-1 are the leaves (one triangle each, `leaf`), then each inner node after its children; the root is
    last. child: (nodes, 2), -1 for leaves; layer: -1 where both; flat: (nodes, 4) box in material coordinates, grown by
    half an edge; size: triangles below; beside: (m, 3) leaves at a leaf's edges. vertex, edge: (m, 3) of which a leaf
    is the owner, -1 elsewhere: each pair of primitives is met once; of_vertex, of_tri, of_edge: the leaf that has
    each. box: (nodes, 6); normal: (nodes, 6); speed: (nodes, 7) bounds, the last of the slack; stale: (nodes,) to be
    searched. place: (n, 3) foreseen; face: (m, 3) normals; edge_box: (e, 6). stack: scratch."""

    leaf: NDArray[np.int32]
    child: NDArray[np.int32]
    layer: NDArray[np.int32]
    flat: Array
    size: NDArray[np.int32]
    beside: NDArray[np.int32]
    vertex: NDArray[np.int32]
    edge: NDArray[np.int32]
    of_vertex: NDArray[np.int32]
    of_tri: NDArray[np.int32]
    of_edge: NDArray[np.int32]
    box: Array
    normal: Array
    speed: Array
    stale: NDArray[np.bool_]
    place: Array
    face: Array
    edge_box: Array
    stack: NDArray[np.int32]


def build_tree(mesh: ClothMesh, edge: NDArray[np.int32]) -> Tree:
    """Median splits of each layer along its longer side; `edge`: (e, 2) in the order that pairs refer to."""
    m = len(mesh.triangles)
    centre = mesh.rest[mesh.triangles].mean(axis=1)
    leaf: list[int] = []
    inner: list[tuple[int, int]] = []

    def split(tris: NDArray[np.intp]) -> int:
        if len(tris) == 1:
            leaf.append(int(tris[0]))
            return len(leaf) - 1
        axis = int(np.argmax(np.ptp(centre[tris], axis=0)))
        order = tris[np.argsort(centre[tris, axis], kind="stable")]
        a, b = split(order[: len(order) // 2]), split(order[len(order) // 2 :])
        inner.append((a, b))
        return m + len(inner) - 1

    roots = [split(np.flatnonzero(mesh.triangle_layer == k)) for k in np.unique(mesh.triangle_layer)]
    if len(roots) == 2:
        inner.append((roots[0], roots[1]))
    nodes = m + len(inner)
    child = np.full((nodes, 2), -1, np.int32)
    child[m:] = np.array(inner, np.int32).reshape(-1, 2)
    grow = 0.5 * float(np.median(mesh.edge_length))
    flat, layer, size = np.zeros((nodes, 4)), np.zeros(nodes, np.int32), np.ones(nodes, np.int32)
    p = mesh.rest[mesh.triangles[leaf]]
    flat[:m] = np.hstack([p.min(axis=1) - grow, p.max(axis=1) + grow])
    layer[:m] = mesh.triangle_layer[leaf]
    for k, (a, b) in enumerate(inner, start=m):
        flat[k] = np.hstack([np.minimum(flat[a, :2], flat[b, :2]), np.maximum(flat[a, 2:], flat[b, 2:])])
        layer[k] = layer[a] if layer[a] == layer[b] else -1
        size[k] = size[a] + size[b]
    vertex, owned = _owners(mesh, edge, leaf)
    of_tri = np.zeros(m, np.int32)
    of_tri[leaf] = np.arange(m)
    return Tree(
        np.array(leaf, np.int32),
        child,
        layer,
        flat,
        size,
        _beside(mesh, leaf),
        vertex,
        owned,
        _leaf_of(vertex, len(mesh.rest)),
        of_tri,
        _leaf_of(owned, len(edge)),
        np.zeros((nodes, 6)),
        np.zeros((nodes, 6)),
        np.zeros((nodes, 7)),
        np.zeros(nodes, np.bool_),
        np.zeros((len(mesh.rest), 3)),
        np.zeros((m, 3)),
        np.zeros((len(edge), 6)),
        np.zeros((STACK, 2), np.int32),
    )


def _beside(mesh: ClothMesh, leaf: list[int]) -> NDArray[np.int32]:
    """(m, 3): the leaves of one layer beside each leaf, -1 at the outline."""
    faces: dict[tuple[int, int, int], list[tuple[int, int]]] = {}
    for k, t in enumerate(leaf):
        tri = mesh.triangles[t].tolist()
        for e in range(3):
            i, j = sorted((tri[e], tri[(e + 1) % 3]))
            faces.setdefault((i, j, int(mesh.triangle_layer[t])), []).append((k, e))
    out = np.full((len(leaf), 3), -1, np.int32)
    for pair in faces.values():
        if len(pair) == 2:
            (a, ea), (b, eb) = pair
            out[a, ea], out[b, eb] = b, a
    return out


def _owners(
    mesh: ClothMesh, edge: NDArray[np.int32], leaf: list[int]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(m, 3) twice: vertices and edges of each leaf that no leaf before it has."""
    number = {(min(e), max(e)): k for k, e in enumerate(edge.tolist())}
    vertex, owned = np.full((len(leaf), 3), -1, np.int32), np.full((len(leaf), 3), -1, np.int32)
    seen_v: set[int] = set()
    seen_e: set[int] = set()
    for k, t in enumerate(leaf):
        tri = mesh.triangles[t].tolist()
        for c in range(3):
            i, j = tri[c], tri[(c + 1) % 3]
            e = number[min(i, j), max(i, j)]
            if i not in seen_v:
                seen_v.add(i)
                vertex[k, c] = i
            if e not in seen_e:
                seen_e.add(e)
                owned[k, c] = e
    return vertex, owned


def _leaf_of(owned: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    out = np.zeros(count, np.int32)
    k, c = np.nonzero(owned >= 0)
    out[owned[k, c]] = k
    return out


@njit(nogil=True, fastmath={"contract"})
def fit_tree(tree, tri, edge, base, course, slack, born, now, span, stale, everything):
    """Boxes about where the vertices are foreseen at `now`: base + (now - born) span course; leaves that neither move
    nor have a stale vertex are as they were. Marks the nodes with something stale."""
    leaf, child, beside, place, face = tree.leaf, tree.child, tree.beside, tree.place, tree.face
    box, speed, normal, marked, edge_box = tree.box, tree.speed, tree.normal, tree.stale, tree.edge_box
    m = len(leaf)
    for i in range(len(stale)):
        age = (now - born[i]) * span
        for c in range(3):
            place[i, c] = base[i, c] + age * course[i, c]
    for k in range(m):
        t = leaf[k]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        marked[k] = everything or stale[p] or stale[q] or stale[r]
        moves = marked[k]
        for c in range(3):
            moves = moves or course[p, c] != 0.0 or course[q, c] != 0.0 or course[r, c] != 0.0
        if not moves:
            continue
        speed[k, 6] = max(slack[p], max(slack[q], slack[r]))
        for c in range(3):
            box[k, c] = min(place[p, c], min(place[q, c], place[r, c]))
            box[k, c + 3] = max(place[p, c], max(place[q, c], place[r, c]))
            speed[k, c] = min(course[p, c], min(course[q, c], course[r, c]))
            speed[k, c + 3] = max(course[p, c], max(course[q, c], course[r, c]))
        ux, uy, uz = place[q, 0] - place[p, 0], place[q, 1] - place[p, 1], place[q, 2] - place[p, 2]
        vx, vy, vz = place[r, 0] - place[p, 0], place[r, 1] - place[p, 1], place[r, 2] - place[p, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        s = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        face[k, 0], face[k, 1], face[k, 2] = nx * s, ny * s, nz * s
    for k in range(m):
        # with the triangles beside it: its edges and vertices are also theirs
        for c in range(3):
            normal[k, c] = normal[k, c + 3] = face[k, c]
        for e in range(3):
            j = beside[k, e]
            if j >= 0:
                for c in range(3):
                    normal[k, c] = min(normal[k, c], face[j, c])
                    normal[k, c + 3] = max(normal[k, c + 3], face[j, c])
    for k in range(m, len(child)):
        a, b = child[k, 0], child[k, 1]
        for c in range(3):
            box[k, c], box[k, c + 3] = min(box[a, c], box[b, c]), max(box[a, c + 3], box[b, c + 3])
            normal[k, c], normal[k, c + 3] = min(normal[a, c], normal[b, c]), max(normal[a, c + 3], normal[b, c + 3])
            speed[k, c], speed[k, c + 3] = min(speed[a, c], speed[b, c]), max(speed[a, c + 3], speed[b, c + 3])
        speed[k, 6] = max(speed[a, 6], speed[b, 6])
        marked[k] = marked[a] or marked[b]
    for e in range(len(edge)):
        i, j = edge[e, 0], edge[e, 1]
        for c in range(3):
            edge_box[e, c], edge_box[e, c + 3] = min(place[i, c], place[j, c]), max(place[i, c], place[j, c])


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
def _neighbours(layer, f, a, b):
    """Whether two regions of one layer lie side by side in the material."""
    if layer[a] != layer[b] or layer[a] < 0:
        return False
    w = min(f[a, 2], f[b, 2]) - max(f[a, 0], f[b, 0])
    h = min(f[a, 3], f[b, 3]) - max(f[a, 1], f[b, 1])
    if w < 0.0 or h < 0.0:
        return False
    return w > 0.5 * min(f[a, 2] - f[a, 0], f[b, 2] - f[b, 0]) or h > 0.5 * min(
        f[a, 3] - f[a, 1], f[b, 3] - f[b, 1]
    )


@njit(nogil=True)
def _touch(tri, s, t):
    """Whether two triangles have a common vertex."""
    p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
    some = False
    for k in range(3):
        i = tri[s, k]
        some = some | (i == p) | (i == q) | (i == r)
    return some


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
    """All pairs with a stale triangle that can come within release distance in `horizon` [s] when no vertex strays
    from its course by more than its slack; -> counts, which may exceed the lists' lengths, or -1 when `met`, the
    scratch for triangles that meet, is too short. Allocates nothing."""
    n = _meeting_leaves(
        tree.leaf, tree.child, tree.layer, tree.size, tree.flat, tree.box, tree.speed, tree.normal, tree.stale, tree.stack,
        tri, horizon, RELEASE * thick, met
    )  # fmt: skip
    if n > len(met):
        return -1, -1
    place, speed = tree.place, tree.speed
    n_vt = _meet(
        n, met, tree.leaf, tree.vertex, tree.box, speed, place, course, tri, RELEASE * thick, horizon, vt
    )
    n_ee = _cross(
        n, met, tree.edge, tree.edge_box, speed, place, course, edge, EDGE_SHARE * RELEASE * thick, horizon, ee
    )
    return n_vt, n_ee


@njit(nogil=True)
def _meeting_leaves(leaf, child, layer, size, flat, box, speed, normal, stale, stack, tri, horizon, near, met):
    """Pairs of leaves whose boxes meet and that are not parts of one smooth region; -> their number."""
    m = len(leaf)
    top, n = 1, 0
    stack[0, 0] = stack[0, 1] = len(child) - 1
    while top > 0:
        top -= 1
        a, b = stack[top, 0], stack[top, 1]
        if not (stale[a] or stale[b]):
            continue
        if a == b:
            if a < m or (layer[a] >= 0 and _smooth(normal, a, a)):
                continue
            c, d = child[a, 0], child[a, 1]
            stack[top, 0] = stack[top, 1] = c
            stack[top + 1, 0] = stack[top + 1, 1] = d
            stack[top + 2, 0], stack[top + 2, 1] = c, d
            top += 3
            continue
        if _apart(box, speed, a, b, horizon, near):
            continue
        if a < m and b < m:
            if layer[a] == layer[b] and _touch(tri, leaf[a], leaf[b]) and _smooth(normal, a, b):
                continue
            if n < len(met):
                met[n, 0], met[n, 1] = a, b
            n += 1
            continue
        if _neighbours(layer, flat, a, b) and _smooth(normal, a, b):
            continue
        if b < m or (a >= m and size[a] >= size[b]):  # open the greater of the two
            stack[top, 0], stack[top, 1] = child[a, 0], b
            stack[top + 1, 0], stack[top + 1, 1] = child[a, 1], b
        else:
            stack[top, 0], stack[top, 1] = a, child[b, 0]
            stack[top + 1, 0], stack[top + 1, 1] = a, child[b, 1]
        top += 2
    return n


@njit(nogil=True)
def _meet(n_met, met, leaf, own, box, speed, place, course, tri, near, horizon, vt):
    """Vertices and triangles that can meet, out of the leaves that do; -> how many."""
    n = 0
    for c in range(2 * n_met):
        s, b = met[c >> 1, c & 1], met[c >> 1, 1 - (c & 1)]
        t = leaf[b]
        reach = near + speed[s, 6] + speed[b, 6]
        for k in range(3):
            i = own[s, k]
            if i >= 0 and _can_meet(place, course, tri, i, t, reach, horizon):
                if n < len(vt):
                    vt[n, 0], vt[n, 1] = i, t
                n += 1
    return n


@njit(nogil=True)
def _cross(n_met, met, own, box, speed, place, course, edge, near, horizon, ee):
    """Edges that can meet, out of the leaves that do; -> how many."""
    n = 0
    for c in range(n_met):
        s, t = met[c, 0], met[c, 1]
        margin = near + speed[s, 6] + speed[t, 6]
        lx = min(0.0, horizon * (speed[t, 0] - speed[s, 3])) - margin
        ly = min(0.0, horizon * (speed[t, 1] - speed[s, 4])) - margin
        lz = min(0.0, horizon * (speed[t, 2] - speed[s, 5])) - margin
        hx = max(0.0, horizon * (speed[t, 3] - speed[s, 0])) + margin
        hy = max(0.0, horizon * (speed[t, 4] - speed[s, 1])) + margin
        hz = max(0.0, horizon * (speed[t, 5] - speed[s, 2])) + margin
        for k in range(3):
            e = own[s, k]
            if e < 0:
                continue
            for m in range(3):
                f = own[t, m]
                if f < 0:
                    continue
                if (
                    (box[f, 0] + lx > box[e, 3])
                    | (box[f, 3] + hx < box[e, 0])
                    | (box[f, 1] + ly > box[e, 4])
                    | (box[f, 4] + hy < box[e, 1])
                    | (box[f, 2] + lz > box[e, 5])
                    | (box[f, 5] + hz < box[e, 2])
                ):  # one branch, not six
                    continue
                if _can_cross(place, course, edge, e, f, margin, horizon):
                    if n < len(ee):
                        ee[n, 0], ee[n, 1] = min(e, f), max(e, f)
                    n += 1
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
