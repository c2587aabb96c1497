"""Clusters of up to LEAF triangles, the units of the broad phase: their arrays, and the function that splits a
cloth into them.

A row is a group of LANES (16) triangles, edges, vertices or boxes that one vector instruction processes together,
and a lane is a place in a row: in an array (rows, k, LANES), a[r, :, i] contains the k numbers of the item in lane
i of row r. The triangles, edges and vertices of each cluster begin in new rows, so lanes at the end of its last
row can be unused; a bit mask of a row has bit i for lane i.

When a cluster is searched for pairs, each of its corners (the vertices of its triangles) gets a straight course,
given by its position and velocity at the time of the search. The cluster is searched again when a corner leaves
its course, when the course has run out, or when a corner has just woken. The neighbouring clusters then keep their
courses, although they share vertices with this cluster: a pair of primitives is valid as long as the courses of
the two clusters that own them are valid. Clusters at rest are not searched, so cloth at rest costs nothing.

The geometry is stored in single precision. A tree of bounding boxes would need fewer tests but more time than the
tests of whole rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from foldcell.robots.errors import InternalError
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, triangle_sides
from foldcell.skills.cloth.simd.aligned_arrays import Table, named_arrays, zeros
from foldcell.skills.cloth.simd.i32x16 import LANES

LEAF = LANES  # largest number of triangles in a cluster: they fill one row
FAR = 1e6  # [m] coordinates in unused lanes, which are thus near nothing; for triangles, see `Clusters`
# Two border sides face each other if the line between their middles leaves both sides outwards, at angles whose
# sines are larger than this.
FACING = 0.1


_TOPOLOGY = (
    "corner", "corner_start", "tri", "tri_at", "edge", "edge_at", "edge_start", "vertex", "vertex_at",
    "vertex_start", "face", "ring", "ring_start", "beside", "beside_start", "smooth", "smooth_start", "of_vertex",
    "of_tri", "of_edge", "at_edge", "edge_beside", "rim",
)  # fmt: skip
"""Names of the arrays that never change, all of int32."""
_GEOMETRY: Table = {
    "box": (np.float32, "groups", 9, LANES),
    "group": (np.float32, "groups", 9),
    "slab": (np.float32, "m", 6),
    "normal": (np.float32, "m", 6),
    "place": (np.float32, 3, "corners"),
    "tri_geo": (np.float32, "m", 15, LANES),
    "edge_geo": (np.float32, "edge_rows", 13, LANES),
    "vertex_geo": (np.float32, "vertex_rows", 7, LANES),
    "bent": (np.int32, "edge_rows"),
    "ridge": (np.int32, "edge_rows"),
    "ridge_before": (np.int32, "edge_rows"),
    "ridges": (np.int32, "m"),
    "ridge_edge": (np.int32, "edge_rows", 3, LANES),
    "fitted": (np.bool_, "m"),
    "stale": (np.bool_, "m"),
    "hit": (np.int32, "hits"),
}
Clusters = named_arrays("Clusters", (*_TOPOLOGY, *_GEOMETRY), __name__)
"""Arrays of the m clusters of a mesh. The module's docstring explains rows and lanes. An array `name` beside a
`name_start` contains one list per cluster: the list of cluster k is name[name_start[k] : name_start[k + 1]].
Unused lanes of indices are -1.

Topology. corner: (corners,) the vertices of each cluster's triangles. Each list has LANES or 2 LANES entries;
the last vertex is repeated to fill it. Clusters with a common vertex have separate corners for it, each with a
separate course. tri: (m, LANES) the triangles of each cluster. edge, vertex: (rows, LANES) the edges and the
vertices that each cluster owns. tri_at (m, 3, LANES), edge_at (rows, 2, LANES), vertex_at (rows, LANES):
indices of the corners of these triangles, edges and vertices, arbitrary in unused lanes. face: (m, 4, LANES)
each triangle and its three vertices. of_tri, of_edge, of_vertex: for each primitive, the one cluster that owns
it; because it has one owner, a pair is found once. ring: the triangles in each cluster and beside it, each as
cluster x LANES + lane. beside: the clusters of the same layer that share a vertex with a cluster, itself
included. smooth: those clusters of `beside` that cannot touch the cluster as long as all normals of both lean
in one direction.

Bounds of the corners, each stored as middle, extent (half the size) and speed. The bounds are predicted for
the middle of the horizon (the time for which the pairs of a search are valid): in a frame that moves with this
speed, the corners stay within the extent during the whole horizon. box: (groups, 9, LANES) bounds of each
cluster along the axes; cluster k is in lane k % LANES of row k // LANES. group: (groups, 9) common bounds of
the LANES clusters in a row of `box`. slab: (m, 6) mean normal of a cluster and bounds along it. normal: (m, 6)
least and largest components of the normals of the triangles in `ring`, updated only in stale clusters and
their neighbours.

Geometry. place: (3, corners) predicted positions. tri_geo: (m, 15, LANES) of each triangle: box, normal,
offset of its plane, velocity of the middle, largest difference between a corner's velocity and that of the
middle, slack. Unused lanes have the box of arbitrary corners and a zero normal. edge_geo: (rows, 13, LANES) of
each ridge: start, vector to the end, squared length, velocity of the middle, difference between an end's
velocity and that of the middle, slack, inverse squared length. vertex_geo: (rows, 7, LANES) of each vertex:
position, velocity, slack. stale: (m,) True for clusters to be searched. fitted: (m,) True where the geometry
was just updated. hit: (m + LANES,) scratch.

Ridges. at_edge: (e,) position of each edge in `edge`, as row x LANES + lane. edge_beside: (rows, 2, LANES) the
two triangles beside each edge, each as cluster x LANES + lane, 0 if there are not two in one layer. Four bit
masks, (rows,), have one bit per edge. rim: edges without two triangles in one layer. bent: these edges and the
edges at a bend. ridge: the edges of `bent` and those that stay ridges in this search (ridges.py).
ridge_before: the ridges for which edge_geo was computed. edge_geo contains only the ridges, packed from the
first row of each cluster on. ridges: (m,) number of ridges in each cluster. ridge_edge: (rows, 3, LANES) their
edges and end vertices, packed in the same way.
"""


def build_clusters(mesh: ClothMesh, edge: NDArray[np.int32]) -> Any:
    """Return the `Clusters` of a mesh. Each layer is split: each part is halved repeatedly, perpendicular to the
    material axis (x or y) along which it is longer; then clusters that are not connected are split. edge: (e, 2)
    the edges, in the order of the edge numbers in the pairs."""
    centre = mesh.rest[mesh.triangles].mean(axis=1)
    clusters: list[NDArray[np.intp]] = []

    def split(tris: NDArray[np.intp]) -> None:
        count = -(-len(tris) // LEAF)
        if count <= 1:
            clusters.append(tris)
            return
        axis = int(np.argmax(np.ptp(centre[tris], axis=0)))
        order = tris[np.argsort(centre[tris, axis], kind="stable")]
        half = len(order) * (count // 2) // count
        split(order[:half])
        split(order[half:])

    for k in np.unique(mesh.triangle_layer):
        split(np.flatnonzero(mesh.triangle_layer == k))
    clusters = _in_pieces(mesh, _of_few_corners(mesh, _in_pieces(mesh, clusters)))
    m = len(clusters)
    tri_edge, edge_tri = triangle_sides(mesh, edge)
    sheet = mesh.triangle_layer[edge_tri]
    paired = (edge_tri >= 0).all(axis=1) & (sheet[:, 0] == sheet[:, 1])  # edges with two triangles in one layer
    vertices, edges = _shares(mesh, tri_edge, clusters)
    tri, _, of_tri = _lanes(clusters, len(mesh.triangles))
    owned, edge_start, of_edge = _lanes(edges, len(edge))
    vertex, vertex_start, of_vertex = _lanes(vertices, len(mesh.rest))
    corner, corner_start, find = _corners(mesh, clusters)
    slot = _inverse(tri, len(of_tri))
    ring, ring_start = _rows([slot[tris] for tris in _rings(edge_tri[paired], clusters)])
    near = _beside(mesh, clusters)
    beside, beside_start = _rows(near)
    smooth, smooth_start = _rows(_smooth_beside(mesh, clusters, near))
    edge_beside, rim = _beside_edges(edge_tri, paired, owned, slot)
    made = Clusters(
        corner=corner, corner_start=corner_start, tri=tri, edge=owned, edge_start=edge_start, vertex=vertex,
        tri_at=find(of_tri[tri][..., None], mesh.triangles[tri]).transpose(0, 2, 1).copy(),
        edge_at=find(of_edge[owned][..., None], edge[owned]).transpose(0, 2, 1).copy(),
        vertex_at=find(of_vertex[vertex], vertex), vertex_start=vertex_start,
        face=_with_corners(tri, mesh.triangles), ring=ring, ring_start=ring_start, beside=beside,
        beside_start=beside_start, smooth=smooth, smooth_start=smooth_start, of_vertex=of_vertex, of_tri=of_tri,
        of_edge=of_edge, at_edge=_inverse(owned, len(edge)), edge_beside=edge_beside, rim=rim,
        **zeros(
            _GEOMETRY, m=m, groups=-(-m // LANES), corners=len(corner), edge_rows=len(owned),
            vertex_rows=len(vertex), hits=m + LANES,
        ),
    )  # fmt: skip
    made.box[:, :3] = made.edge_geo[:, :3] = made.vertex_geo[:, :3] = FAR
    made.edge_geo[:, 3:7] = made.edge_geo[:, 12] = 1.0
    made.bent[:] = made.ridge[:] = rim
    made.ridge_edge[:] = -1
    return made


def _with_corners(owned: NDArray[np.int32], corners: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return (rows, 1 + k, LANES): each index in `owned`, followed by its row of `corners` (n, k); -1 in unused
    lanes."""
    vertices = np.where(owned[..., None] < 0, -1, corners[owned])
    numbers = np.concatenate([owned[:, None], vertices.transpose(0, 2, 1)], axis=1)
    return np.ascontiguousarray(numbers, dtype=np.int32)


def _inverse(owned: NDArray[np.int32], n: int) -> NDArray[np.int32]:
    """Return (n,): the position of each index from 0 to n - 1 in `owned`, as row x LANES + lane."""
    at = np.zeros(n, np.int32)
    at[owned[owned >= 0]] = np.flatnonzero(owned.ravel() >= 0)
    return at


def _beside_edges(
    edge_tri: NDArray[np.int32], paired: NDArray[np.bool_], owned: NDArray[np.int32], slot: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the two triangles beside each edge of `owned`, (rows, 2, LANES). A triangle is stated as
    cluster x LANES + lane. An edge is `paired` if it has two triangles of one layer; without them both values are
    0. Also return a bit mask per row, (rows,): bit i is set if the edge in lane i is not paired."""
    inside = (owned >= 0) & paired[owned]
    beside = np.where(inside[:, None], slot[edge_tri[owned]].transpose(0, 2, 1), 0)
    rim = ((owned >= 0) & ~inside) @ (1 << np.arange(LANES))
    return np.ascontiguousarray(beside, dtype=np.int32), rim.astype(np.int32)


def _corners(
    mesh: ClothMesh, clusters: list[NDArray[np.intp]]
) -> tuple[NDArray[np.int32], NDArray[np.int32], Callable[..., NDArray[np.int32]]]:
    """Return the corners, the index of each cluster's first corner, and a function (clusters, vertices) ->
    corners."""
    n = len(mesh.rest)
    lists = [np.unique(mesh.triangles[tris]) for tris in clusters]
    padded = [np.pad(v, (0, -len(v) % LANES), mode="edge") for v in lists]
    corner, start = _rows(padded)
    most = max(map(len, padded))
    if most > 2 * LANES:  # cluster_bounds.py reads at most two rows per cluster
        raise InternalError("a cluster of too many corners", corners=most)
    number = np.full((len(clusters), n), -1, np.int32)
    for k, v in enumerate(lists):
        number[k, v] = start[k] + np.arange(len(v))
    return corner, start, lambda cluster, vertex: number[cluster, vertex]


def _rows(lists: Sequence[NDArray[np.integer]]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Concatenate the lists. Returns the numbers and the index at which each list begins."""
    start = np.concatenate([[0], np.cumsum([len(k) for k in lists])]).astype(np.int32)
    return np.concatenate(lists).astype(np.int32), start


def _lanes(
    lists: list[NDArray[np.intp]], n: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Write the lists into rows of LANES, each list beginning in a new row. Returns the rows (-1 in unused lanes),
    the first row of each list, and for each of n indices the list that contains it."""
    start = np.concatenate([[0], np.cumsum([-(-len(k) // LANES) for k in lists])]).astype(np.int32)
    rows, of = np.full((start[-1], LANES), -1, np.int32), np.zeros(n, np.int32)
    for k, members in enumerate(lists):
        rows[start[k] : start[k + 1]].reshape(-1)[: len(members)] = members
        of[members] = k
    return rows, start, of


def _shares(
    mesh: ClothMesh, tri_edge: NDArray[np.int32], clusters: list[NDArray[np.intp]]
) -> tuple[list[NDArray[np.intp]], list[NDArray[np.intp]]]:
    """Return the vertices and the edges that each cluster owns. A vertex or edge has one owner among the clusters
    that contain it: a vertex the first of these clusters, an edge the one with the fewest edges so far."""
    vertex_free = np.ones(len(mesh.rest), bool)
    vertices: list[NDArray[np.intp]] = []
    touching: dict[int, list[int]] = {}
    for k, tris in enumerate(clusters):
        v = np.unique(mesh.triangles[tris])
        for e in np.unique(tri_edge[tris]).tolist():
            touching.setdefault(e, []).append(k)
        vertices.append(v[vertex_free[v]].astype(np.intp))
        vertex_free[v] = False
    edges: list[list[int]] = [[] for _ in clusters]
    for e in sorted(touching, key=lambda e: (len(touching[e]), touching[e][0], e)):
        edges[min(touching[e], key=lambda k: len(edges[k]))].append(e)
    return vertices, [np.array(sorted(e), np.intp) for e in edges]


def _rings(paired: NDArray[np.int32], clusters: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """Return for each cluster its triangles and the triangles of its layer that share an edge with one of them.
    paired: (k, 2) the triangles of one layer that share an edge."""
    ring: list[set[int]] = [set(map(int, tris)) for tris in clusters]
    of = {t: k for k, tris in enumerate(ring) for t in list(tris)}
    for pair in paired.tolist():
        for t in pair:
            ring[of[t]].update(pair)
    return [np.array(sorted(tris), np.intp) for tris in ring]


def _beside(mesh: ClothMesh, clusters: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """Return for each cluster the clusters of its layer that share a vertex with it, itself included."""
    at: dict[tuple[int, int], set[int]] = {}
    keys = [
        {(int(mesh.triangle_layer[tris[0]]), v) for v in mesh.triangles[tris].ravel().tolist()}
        for tris in clusters
    ]
    for k, own in enumerate(keys):
        for key in own:
            at.setdefault(key, set()).add(k)
    return [np.array(sorted(set.union(*(at[key] for key in own))), np.intp) for own in keys]


def _smooth_beside(
    mesh: ClothMesh, clusters: list[NDArray[np.intp]], beside: list[NDArray[np.intp]]
) -> list[NDArray[np.intp]]:
    """Return for each cluster those clusters of `beside` whose borders do not face its borders (FACING). Borders
    face each other in a notch, as between the legs of pants: there, cloth can meet cloth edge to edge even if it
    is flat. A border side counts for every cluster that contains one of its ends."""
    end, middle, outward, layer = _borders(mesh)
    rims = []
    for tris in clusters:
        own = np.isin(end, mesh.triangles[tris]).any(axis=1) & (layer == mesh.triangle_layer[tris[0]])
        rims.append((middle[own], outward[own]))

    def facing(a: int, b: int) -> bool:
        (mine, my_way), (its, its_way) = rims[a], rims[b]
        if not (len(mine) and len(its)):
            return False
        between = its[None] - mine[:, None]
        least = FACING * np.linalg.norm(between, axis=2)
        ahead, behind = np.einsum("abk,ak->ab", between, my_way), -np.einsum("abk,bk->ab", between, its_way)
        return bool(((ahead > least) & (behind > least)).any())

    return [np.array([b for b in near if not facing(a, int(b))], np.intp) for a, near in enumerate(beside)]


def _borders(mesh: ClothMesh) -> tuple[NDArray[np.int32], Array, Array, NDArray[np.int32]]:
    """Find the sides of triangles at which a layer ends. Returns their end vertices (k, 2), their middles and
    outward normals (k, 2, in material coordinates), and their layers (k,)."""
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    layer, opposite = np.repeat(mesh.triangle_layer, 3), np.roll(mesh.triangles, -2, axis=1).ravel()
    side = np.column_stack([np.sort(ends, axis=1), layer])
    _, which, count = np.unique(side, axis=0, return_inverse=True, return_counts=True)
    alone = count[which.ravel()] == 1
    ends, layer, opposite = ends[alone], layer[alone], opposite[alone]
    start, end = mesh.rest[ends[:, 0]], mesh.rest[ends[:, 1]]
    middle, along = 0.5 * (start + end), end - start
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    inward = ((mesh.rest[opposite] - middle) * normal).sum(axis=1) > 0.0
    return ends, middle, np.where(inward[:, None], -normal, normal), layer


def _in_pieces(mesh: ClothMesh, clusters: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """Split the clusters into connected parts, because a cluster may have parts on both sides of a notch."""
    t = len(mesh.triangles)
    of = np.zeros(t, np.int64)
    for k, tris in enumerate(clusters):
        of[tris] = k
    corners, corner = np.unique(of[:, None] * len(mesh.rest) + mesh.triangles, return_inverse=True)
    touches = (np.ones(3 * t), (np.repeat(np.arange(t), 3), t + corner.ravel()))
    _, part = connected_components(csr_array(touches, shape=(t + len(corners),) * 2), directed=False)
    return [tris[part[tris] == k] for tris in clusters for k in dict.fromkeys(part[tris].tolist())]


def _of_few_corners(mesh: ClothMesh, clusters: list[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
    """Halve the clusters that have more corners than two rows of LANES hold. This happens where most triangles
    share only one corner with another triangle."""
    fit = [len(np.unique(mesh.triangles[tris])) <= 2 * LANES for tris in clusters]
    halves = [
        (tris,) if fits else (tris[: LEAF // 2], tris[LEAF // 2 :])
        for tris, fits in zip(clusters, fit, strict=True)
    ]
    return [tris for parts in halves for tris in parts]
