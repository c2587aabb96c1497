"""Neighbourhoods and clusters of a mesh: the part of the solver's data that depends on the mesh alone.

An optimiser simulates one mesh hundreds of times, so all of this is built once per mesh.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.cloth.clusters import Clusters, build_clusters
from foldcell.skills.cloth.elasticity import colour_batches, shuffled
from foldcell.skills.cloth.mesh import ClothMesh, edge_finder, triangle_sides
from foldcell.skills.cloth.simd.aligned_arrays import aligned

MESHES = 16  # number of meshes whose topology is cached


class Topology(NamedTuple):
    """Neighbourhoods and clusters of a mesh. Edge numbers are those after shuffling (`shuffled`); the contact
    pairs use the same numbers.

    tri_edge: (t, 3) edges of each triangle; edge_tri: (e, 2) triangles beside each edge, -1 where there is none.
    ring, ring_edge: for vertex i, entries ring_start[i] to ring_start[i + 1] - 1 are its neighbours and the edges
    to them. batch_order: (e,) the edges in colour batches; batch_start: the start of each batch in batch_order,
    then the end of the last batch (`colour_batches`).
    """

    tri_edge: NDArray[np.int32]
    edge_tri: NDArray[np.int32]
    ring_start: NDArray[np.int32]
    ring: NDArray[np.int32]
    ring_edge: NDArray[np.int32]
    batch_order: NDArray[np.int64]
    batch_start: NDArray[np.int64]
    clusters: Any


def topology_of(mesh: ClothMesh) -> Topology:
    """Return the topology of a mesh. The clusters are a separate copy, because the simulation writes into them."""
    known = _build(mesh)
    return known._replace(clusters=Clusters._make(map(aligned, known.clusters)))


@lru_cache(maxsize=MESHES)
def _build(mesh: ClothMesh) -> Topology:
    n, edge = len(mesh.rest), mesh.edges[shuffled(len(mesh.edges))]
    tri_edge, edge_tri = triangle_sides(mesh, edge)
    both = np.concatenate([edge, edge[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    start = np.searchsorted(both[:, 0], np.arange(n + 1)).astype(np.int32)
    ring = np.ascontiguousarray(both[:, 1], dtype=np.int32)
    ring_edge = edge_finder(edge, n)(both[:, 0], both[:, 1])
    return Topology(tri_edge, edge_tri, start, ring, ring_edge, *colour_batches(edge), build_clusters(mesh, edge))
