"""Clusters and their bounds against numpy."""

from types import SimpleNamespace

import numpy as np

from foldcell.skills.cloth.broad_phase.cluster_bounds import fit_clusters
from foldcell.skills.cloth.clusters import LEAF, _of_few_corners
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.simd.i32x16 import LANES
from foldcell.skills.cloth.state import new_pairs, new_state
from foldcell.skills.cloth.topology import topology_of
from tests.builders.cloth import EVERY_EDGE, call

NOTCHED = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.25], [0.16, 0.25], [0.15, 0.06], [0.14, 0.25], [0.0, 0.25]])
MESH = mesh_from_contour(NOTCHED, 0.02, layers=2)


def test_the_geometry_of_triangles_agrees_with_their_corners():
    """This includes clusters with two rows of corners. Places without a triangle have no normal."""
    rng = np.random.default_rng(5)
    clusters = topology_of(MESH).clusters
    m, corners = len(clusters.tri), len(clusters.corner)
    base = rng.normal(size=(3, corners)).astype(np.float32)
    course = 0.3 * rng.normal(size=(3, corners)).astype(np.float32)
    slack = rng.random(m).astype(np.float32)
    born, moving = rng.integers(80, 100, m).astype(np.int32), np.ones(m, bool)
    call(fit_clusters, clusters, base, course, slack, born, moving, 100, 0.001, 0.012, True, EVERY_EDGE)
    assert set(np.diff(clusters.corner_start)) == {LANES, 2 * LANES}
    for k in range(m):
        own = slice(clusters.corner_start[k], clusters.corner_start[k + 1])
        at = {v: c for c, v in reversed(list(enumerate(clusters.corner[own].tolist())))}
        there = clusters.tri[k] >= 0
        which = np.array([[at[v] for v in t] for t in MESH.triangles[clusters.tri[k, there]]])
        place = (base + (0.001 * (100 - born[k]) + 0.012) * course)[:, own].T[which]
        speed = course[:, own].T[which]
        normal = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        mean = speed.mean(axis=1)
        differs = np.linalg.norm(speed - mean[:, None], axis=2).max(axis=1)
        expected = np.column_stack([
            place.min(axis=1), place.max(axis=1), normal, (normal * place[:, 0]).sum(axis=1), mean, differs,
            np.full(len(place), slack[k]),
        ])  # fmt: skip
        found = clusters.tri_geo[k].T
        np.testing.assert_allclose(found[there], expected, rtol=1e-4, atol=1e-5)
        assert not found[~there, 6:9].any()


def test_a_cluster_has_no_more_corners_than_two_rows_hold():
    """A cluster of triangles that share only one corner with the next one is split. Other clusters do not
    change."""
    chain = np.arange(2 * LEAF).reshape(-1, 2)
    chain = np.column_stack([chain, chain[:, 1] + 1])
    strip = np.arange(LEAF)[:, None] + np.arange(3)
    mesh = SimpleNamespace(triangles=np.vstack([chain, strip]))
    given = [np.arange(LEAF), LEAF + np.arange(LEAF)]
    made = _of_few_corners(mesh, given)
    np.testing.assert_array_equal(np.concatenate(made), np.concatenate(given))
    assert [len(tris) for tris in made] == [LEAF // 2, LEAF // 2, LEAF]
    assert all(len(np.unique(mesh.triangles[tris])) <= 2 * LANES for tris in made)


def test_arrays_for_vector_instructions_are_cache_aligned():
    clusters = topology_of(MESH).clusters
    state = new_state(20, 30, 4, 25, 25, clusters)
    for made in (clusters, state, new_pairs(50, 40)):
        for name, array in made._asdict().items():
            # these arrays are read one value at a time
            if array.size and name not in ("awake", "expired", "ridge_searched", "top_row"):
                assert array.ctypes.data % 64 == 0, name
