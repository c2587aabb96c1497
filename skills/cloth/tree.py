# mypy: allow-untyped-defs, allow-incomplete-defs
"""The search for pairs that may touch: a tree of boxes over the mesh, with bounds on the normals.

The tree follows the mesh (it is built once, on the flat garment) and its boxes are fitted anew at each search,
swept over where the vertices will go until the next one. A smooth stretch of cloth cannot touch itself: a
region all of whose normals lie in one half space is not searched against itself or its neighbours (Volino &
Magnenat-Thalmann 1994), so that only layers that really face each other cost anything.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robots.ports import Array
from skills.cloth.contact import EDGE_SHARE, RELEASE, closest_on_segments
from skills.cloth.mesh import ClothMesh

__all__ = ["Tree", "build_tree", "search_pairs"]

SMOOTH = 0.15  # how far the normals of a region have to lean towards one direction for it to be smooth
SMALL = 8  # triangles: regions so small are neighbours also across a corner
STACK = 4096


class Tree(NamedTuple):
    """Nodes 0..m-1 are the leaves (one triangle each, `leaf`), then each inner node after its children; the
    root is last. child: (nodes, 2), -1 for leaves; layer: -1 where both; flat: (nodes, 4) box in material
    coordinates, grown by half an edge; size: triangles below; beside: (m, 3) leaves at its edges.
    vertex, edge: (m, 3) of which a triangle is the
    owner, -1 elsewhere: each pair of primitives is met once."""

    leaf: NDArray[np.int32]
    child: NDArray[np.int32]
    layer: NDArray[np.int32]
    flat: Array
    size: NDArray[np.int32]
    vertex: NDArray[np.int32]
    edge: NDArray[np.int32]
    box: Array
    normal: Array
    awake: NDArray[np.bool_]
    beside: NDArray[np.int32]
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
    vertex, owned = _owners(mesh, edge)
    return Tree(
        np.array(leaf, np.int32),
        child,
        layer,
        flat,
        size,
        vertex,
        owned,
        np.zeros((nodes, 6)),
        np.zeros((nodes, 6)),
        np.zeros(nodes, np.bool_),
        _beside(mesh, leaf),
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


def _owners(mesh: ClothMesh, edge: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    number = {tuple(sorted(e)): k for k, e in enumerate(edge.tolist())}
    vertex, owned = (
        np.full((len(mesh.triangles), 3), -1, np.int32),
        np.full((len(mesh.triangles), 3), -1, np.int32),
    )
    seen_v: set[int] = set()
    seen_e: set[int] = set()
    for t, tri in enumerate(mesh.triangles.tolist()):
        for k in range(3):
            i, e = tri[k], number[tuple(sorted((tri[k], tri[(k + 1) % 3])))]
            if i not in seen_v:
                seen_v.add(i)
                vertex[t, k] = i
            if e not in seen_e:
                seen_e.add(e)
                owned[t, k] = e
    return vertex, owned


@njit(nogil=True, fastmath={"contract"})
def _fit(leaf, child, beside, face, box, normal, busy, tri, x, v, awake, horizon, margin):
    """Boxes swept over `horizon` [s] and grown by `margin` [m], bounds of the normals, who is awake."""
    m = len(tri)
    for k in range(m):
        t = leaf[k]
        p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
        for c in range(3):
            a0, a1, a2 = x[p, c], x[q, c], x[r, c]
            b0, b1, b2 = a0 + horizon * v[p, c], a1 + horizon * v[q, c], a2 + horizon * v[r, c]
            box[k, c] = min(min(min(a0, b0), min(a1, b1)), min(a2, b2)) - margin
            box[k, c + 3] = max(max(max(a0, b0), max(a1, b1)), max(a2, b2)) + margin
        ux, uy, uz = x[q, 0] - x[p, 0], x[q, 1] - x[p, 1], x[q, 2] - x[p, 2]
        vx, vy, vz = x[r, 0] - x[p, 0], x[r, 1] - x[p, 1], x[r, 2] - x[p, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        s = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
        face[k, 0], face[k, 1], face[k, 2] = nx * s, ny * s, nz * s
        busy[k] = awake[p] or awake[q] or awake[r]
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
            box[k, c] = min(box[a, c], box[b, c])
            box[k, c + 3] = max(box[a, c + 3], box[b, c + 3])
            normal[k, c] = min(normal[a, c], normal[b, c])
            normal[k, c + 3] = max(normal[a, c + 3], normal[b, c + 3])
        busy[k] = busy[a] or busy[b]


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
def _neighbours(layer, size, f, a, b):
    """Whether two regions of one layer lie side by side in the material."""
    if layer[a] != layer[b] or layer[a] < 0:
        return False
    w = min(f[a, 2], f[b, 2]) - max(f[a, 0], f[b, 0])
    h = min(f[a, 3], f[b, 3]) - max(f[a, 1], f[b, 1])
    if w < 0.0 or h < 0.0:
        return False
    if size[a] <= SMALL and size[b] <= SMALL:
        return True
    return w > 0.5 * min(f[a, 2] - f[a, 0], f[b, 2] - f[b, 0]) or h > 0.5 * min(
        f[a, 3] - f[a, 1], f[b, 3] - f[b, 1]
    )


@njit(nogil=True)
def search_pairs(tree, met, tri, edge, x, v, awake, thick, horizon, slack, vt, ee):
    """All pairs, one of their vertices awake, that can come within release distance in `horizon` [s] when no
    vertex strays from its straight course by more than `slack` [m]; -> counts, which may exceed the lists'
    lengths, or -1 when `met`, the scratch for triangles that meet, is too short."""
    _fit(
        tree.leaf,
        tree.child,
        tree.beside,
        tree.face,
        tree.box,
        tree.normal,
        tree.awake,
        tri,
        x,
        v,
        awake,
        horizon,
        0.5 * RELEASE * thick + slack,
    )
    near_vt, near_ee = RELEASE * thick + 2.0 * slack, EDGE_SHARE * RELEASE * thick + 2.0 * slack
    n = _meeting_leaves(
        tree.leaf, tree.child, tree.layer, tree.size, tree.flat, tree.box, tree.normal, tree.awake, tree.stack, met
    )
    if n > len(met):
        return -1, -1
    return _primitive_pairs(
        n, met, tree.edge_box, tree.vertex, tree.edge, tri, edge, x, v, awake, near_vt, near_ee, horizon, vt, ee
    )


@njit(nogil=True)
def _meeting_leaves(leaf, child, layer, size, flat, box, normal, awake, stack, met):
    """Pairs of triangles whose boxes meet and that are not parts of one smooth region; -> their number."""
    top, n = 1, 0
    stack[0, 0] = stack[0, 1] = len(child) - 1
    while top > 0:
        top -= 1
        a, b = stack[top, 0], stack[top, 1]
        if a == b:
            if child[a, 0] < 0 or not awake[a] or (layer[a] >= 0 and _smooth(normal, a, a)):
                continue
            c, d = child[a, 0], child[a, 1]
            stack[top, 0] = stack[top, 1] = c
            stack[top + 1, 0] = stack[top + 1, 1] = d
            stack[top + 2, 0], stack[top + 2, 1] = c, d
            top += 3
            continue
        if not (awake[a] or awake[b]):
            continue
        if (
            (box[a, 0] > box[b, 3])
            | (box[b, 0] > box[a, 3])
            | (box[a, 1] > box[b, 4])
            | (box[b, 1] > box[a, 4])
            | (box[a, 2] > box[b, 5])
            | (box[b, 2] > box[a, 5])
        ):  # one branch, not six
            continue
        if _neighbours(layer, size, flat, a, b) and _smooth(normal, a, b):
            continue
        if child[a, 0] < 0 and child[b, 0] < 0:
            if n < len(met):
                met[n, 0], met[n, 1] = leaf[a], leaf[b]
            n += 1
        elif child[b, 0] < 0 or (child[a, 0] >= 0 and size[a] >= size[b]):  # open the greater of the two
            stack[top, 0], stack[top, 1] = child[a, 0], b
            stack[top + 1, 0], stack[top + 1, 1] = child[a, 1], b
            top += 2
        else:
            stack[top, 0], stack[top, 1] = a, child[b, 0]
            stack[top + 1, 0], stack[top + 1, 1] = a, child[b, 1]
            top += 2
    return n


@njit(nogil=True, fastmath={"contract"})
def _edge_boxes(edge, x, v, horizon, margin, out):
    for e in range(len(edge)):
        i, j = edge[e, 0], edge[e, 1]
        for c in range(3):
            a0, a1 = x[i, c], x[j, c]
            b0, b1 = a0 + horizon * v[i, c], a1 + horizon * v[j, c]
            out[e, c] = min(min(a0, b0), min(a1, b1)) - margin
            out[e, c + 3] = max(max(a0, b0), max(a1, b1)) + margin


@njit(nogil=True)
def _primitive_pairs(
    n_met, met, box, own_vertex, own_edge, tri, edge, x, v, awake, near_vt, near_ee, horizon, vt, ee
):
    """Vertex-triangle and edge-edge pairs out of the meeting triangles; -> how many of each."""
    _edge_boxes(edge, x, v, horizon, 0.5 * near_ee, box)
    n_vt = n_ee = 0
    for c in range(n_met):
        s, t = met[c, 0], met[c, 1]
        for k in range(3):
            i, j = own_vertex[s, k], own_vertex[t, k]
            if i >= 0 and _can_meet(x, v, awake, tri, i, t, near_vt, horizon):
                if n_vt < len(vt):
                    vt[n_vt, 0], vt[n_vt, 1] = i, t
                n_vt += 1
            if j >= 0 and _can_meet(x, v, awake, tri, j, s, near_vt, horizon):
                if n_vt < len(vt):
                    vt[n_vt, 0], vt[n_vt, 1] = j, s
                n_vt += 1
        for k in range(3):
            e = own_edge[s, k]
            if e < 0:
                continue
            for m in range(3):
                f = own_edge[t, m]
                if f < 0:
                    continue
                if (
                    (box[e, 0] > box[f, 3])
                    | (box[f, 0] > box[e, 3])
                    | (box[e, 1] > box[f, 4])
                    | (box[f, 1] > box[e, 4])
                    | (box[e, 2] > box[f, 5])
                    | (box[f, 2] > box[e, 5])
                ):
                    continue
                if _can_cross(x, v, awake, edge, e, f, near_ee, horizon):
                    if n_ee < len(ee):
                        ee[n_ee, 0], ee[n_ee, 1] = min(e, f), max(e, f)
                    n_ee += 1
    return n_vt, n_ee


@njit(nogil=True, inline="always")
def _parting(v, i, j):
    dx, dy, dz = v[i, 0] - v[j, 0], v[i, 1] - v[j, 1], v[i, 2] - v[j, 2]
    return dx * dx + dy * dy + dz * dz


@njit(nogil=True, fastmath={"contract"})
def _can_meet(x, v, awake, tri, i, t, near, horizon):
    p, q, r = tri[t, 0], tri[t, 1], tri[t, 2]
    if i in (p, q, r) or not (awake[i] or awake[p] or awake[q] or awake[r]):
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
def _can_cross(x, v, awake, edge, e, f, near, horizon):
    i, j, k, m = edge[e, 0], edge[e, 1], edge[f, 0], edge[f, 1]
    if i in (k, m) or j in (k, m) or not (awake[i] or awake[j] or awake[k] or awake[m]):
        return False
    speed2 = max(max(_parting(v, i, k), _parting(v, i, m)), max(_parting(v, j, k), _parting(v, j, m)))
    reach = near + horizon * np.sqrt(speed2)
    _, _, dx, dy, dz = closest_on_segments(x, i, j, k, m)
    return dx * dx + dy * dy + dz * dz <= reach * reach
