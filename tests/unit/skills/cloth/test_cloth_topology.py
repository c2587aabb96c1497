"""Neighbours in a mesh against direct counting, and arrays shared between simulations."""

import numpy as np
import pytest

from foldcell.skills.cloth.elasticity import shuffled
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.topology import topology_of

SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


@pytest.mark.parametrize("layers", [1, 2])
def test_neighbours_agree_with_direct_counting(layers):
    mesh = mesh_from_contour(SQUARE, 0.03, layers=layers)
    edge = mesh.edges[shuffled(len(mesh.edges))].tolist()
    found = topology_of(mesh)
    for t, tri in enumerate(mesh.triangles.tolist()):
        sides = {frozenset(edge[e]) for e in found.tri_edge[t]}
        assert sides == {frozenset((tri[k], tri[k - 1])) for k in range(3)}
    for e, ends in enumerate(edge):
        beside = [t for t, tri in enumerate(mesh.triangles.tolist()) if set(ends) <= set(tri)]
        assert [t for t in found.edge_tri[e] if t >= 0] == beside
    for i in range(len(mesh.rest)):
        of = slice(found.ring_start[i], found.ring_start[i + 1])
        assert found.ring[of].tolist() == sorted({j for ends in edge if i in ends for j in ends} - {i})
        for j, e in zip(found.ring[of], found.ring_edge[of], strict=True):
            assert set(edge[e]) == {i, j}


def test_writable_arrays_are_not_shared_between_topologies():
    mesh = mesh_from_contour(SQUARE, 0.03)
    one, other = topology_of(mesh), topology_of(mesh)
    assert one.ring is other.ring
    assert not any(np.shares_memory(a, b) for a, b in zip(one.clusters, other.clusters, strict=True))
