"""Edges that can touch other edges: those where a sheet is bent, and those at rims."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.skills.cloth.broad_phase.cluster_bounds import fit_clusters
from foldcell.skills.cloth.clusters import build_clusters
from foldcell.skills.cloth.contact.contacts import edge_distance
from foldcell.skills.cloth.contact.ridges import flat_cosine, note_ridges, stay_ridges
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.state import new_pairs
from tests.builders.cloth import EVERY_EDGE, call

SQUARE = np.array([[-0.15, -0.12], [0.15, -0.12], [0.15, 0.12], [-0.15, 0.12]])
THICK, EDGE = 0.003, 0.025


def ridges_of(mesh, x, flat):
    """Two masks over the edges: bent or at a rim, and at a rim."""
    edges = mesh.edges.astype(np.int32)
    clusters = build_clusters(mesh, edges)
    base = np.ascontiguousarray(x[clusters.corner].T, np.float32)
    m = len(clusters.tri)
    call(fit_clusters,
        clusters, base, 0.0 * base, np.zeros(m, np.float32), np.zeros(m, np.int32), np.ones(m, bool), 0, 0.001,
        0.0, True, np.float32(flat)
    )  # fmt: skip
    slot = clusters.at_edge
    assert (clusters.edge.ravel()[slot] == np.arange(len(edges))).all()
    return (clusters.bent[slot // 16] >> slot % 16 & 1).astype(bool), (
        clusters.rim[slot // 16] >> slot % 16 & 1
    ).astype(bool)


def angles(mesh, x):
    """Angle between the triangles beside each edge [rad]; NaN without two triangles of one layer."""
    normal = np.cross(
        x[mesh.triangles[:, 1]] - x[mesh.triangles[:, 0]], x[mesh.triangles[:, 2]] - x[mesh.triangles[:, 0]]
    )
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    beside = {}
    for t, tri in enumerate(mesh.triangles.tolist()):
        for k in range(3):
            beside.setdefault(tuple(sorted((tri[k], tri[(k + 1) % 3]))), []).append(t)
    out = []
    for e in mesh.edges.tolist():
        pair = beside[tuple(sorted(e))]
        one_layer = len(pair) == 2 and mesh.triangle_layer[pair[0]] == mesh.triangle_layer[pair[1]]
        out.append(np.arccos(np.clip(normal[pair[0]] @ normal[pair[1]], -1, 1)) if one_layer else np.nan)
    return np.array(out)


@pytest.mark.parametrize("layers", [1, 2])
def test_ridges_are_where_the_cloth_is_bent_and_rims_always_count(layers):
    mesh = mesh_from_contour(SQUARE, EDGE, layers)
    x = mesh.lay_flat(THICK)
    x[:, 2] += 0.04 * np.abs(x[:, 0] / 0.15) ** 1.5  # increasingly bent towards the middle
    angle, limit = angles(mesh, x), np.arccos(flat_cosine(THICK, EDGE))
    ridge, rim = ridges_of(mesh, x, flat_cosine(THICK, EDGE))
    np.testing.assert_array_equal(rim, np.isnan(angle))
    clear = rim | (np.abs(angle - limit) > 1e-3)
    np.testing.assert_array_equal(ridge[clear], (rim | (angle > limit))[clear])
    assert (ridge & ~rim).any() and (~ridge).any()
    assert ridges_of(mesh, x, EVERY_EDGE)[0].all()


def distance(p, q, r, s):
    """Distance of the lines through p, q and r, s."""
    across = np.cross(q - p, s - r)
    return abs((r - p) @ across) / np.linalg.norm(across)


@settings(deadline=None)
@given(st.integers(0, 10**6), st.floats(0.01, 0.03), st.floats(0.001, 0.006))
def test_vertices_keep_edges_apart_where_an_edge_is_flat(seed, length, thick):
    """Two triangles form a roof or valley, bent by nearly twice the angle of a ridge. Another edge crosses it,
    with its ends at least a thickness above the triangles. The two edges are then farther apart than the distance
    at which edges push."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-1.95, 1.95) * np.arccos(flat_cosine(thick, length))
    height = np.sqrt(0.75) * length
    # the roof's edge is along y, and its eaves are at x = -height and height
    slope = np.tan(0.5 * angle)
    ends = np.array([[rng.uniform(-1.0, -0.02), 0, 0], [rng.uniform(0.02, 1.0), 0, 0]])
    over = np.column_stack([height * ends[:, 0], rng.uniform(-0.5, 0.5, 2) * length, np.zeros(2)])
    over[:, 2] = -slope * np.abs(over[:, 0]) + thick * np.hypot(1.0, slope) * rng.uniform(1.0, 1.2, 2)
    if np.linalg.norm(over[1] - over[0]) > length:  # no edge of the mesh is this long
        return
    assert distance(np.zeros(3), np.array([0.0, length, 0.0]), *over) > edge_distance(thick)


def test_edges_that_are_near_each_other_stay_ridges():
    pairs, ridge = new_pairs(8, 8), np.zeros(3, np.int32)
    pairs.ee[:3] = [[0, 1], [2, 3], [4, 5]]
    pairs.near[:3] = [True, False, True]
    at = np.array([0, 17, 3, 4, 47, 32], np.int32)
    call(stay_ridges, 2, pairs.ee, pairs.near, at, ridge)
    np.testing.assert_array_equal(ridge, [1, 2, 0])
    call(stay_ridges, 3, pairs.ee, pairs.near, at, ridge)
    np.testing.assert_array_equal(ridge, [1, 2, 1 | 1 << 15])


def test_clusters_with_new_ridges_join_the_next_search():
    """There are three rows of edges. Two belong to a cluster that is not searched now, one to a cluster that
    is."""
    start, stale = np.array([0, 2, 3], np.int32), np.array([False, True])

    def noted(ridge, searched, stale=stale):
        searched, expired = np.array(searched, np.int32), np.array([True, True])
        call(note_ridges, stale, start, np.array(ridge, np.int32), searched, expired)
        return searched.tolist(), expired.tolist()

    assert noted([5, 2, 7], [5, 2, 1]) == ([5, 2, 7], [False, False])
    assert noted([5, 3, 7], [5, 2, 1]) == ([5, 2, 7], [True, False])  # one more ridge
    assert noted([5, 3, 7], [4, 3, 1]) == ([4, 3, 7], [True, False])
    assert noted([4, 2, 0], [5, 2, 1]) == ([4, 2, 0], [False, False])  # one ridge less, which may return
    assert noted([5, 3, 7], [-1, -1, -1]) == ([5, 3, 7], [False, False])
    assert noted([5, 3, 7], [0, 0, 0], np.array([True, False])) == ([5, 3, 0], [False, True])
