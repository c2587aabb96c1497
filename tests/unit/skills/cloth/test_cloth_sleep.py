"""What sleeps beside what is awake does not move it, and folds come to rest; what is packed for the sweeps."""

import numpy as np
import pytest

from benchmarks.cloth.scenes import MATERIAL, RELEASE, SETTLE, frames_of, planned_folds, towel_half, towel_mesh
from skills.cloth.elastic import build_elastic
from skills.cloth.mesh import mesh_from_contour
from skills.cloth.predict import predict_fold
from skills.cloth.settings import SolverSettings
from skills.cloth.sleep import pack
from skills.cloth.solver import ClothSimulation
from skills.cloth.state import AWAKE, EDGES, HINGES, MOVABLE, PACKED


@pytest.fixture(scope="module")
def at_rest():
    """A towel folded in half, at rest with all of it awake."""
    mesh, material = towel_mesh(425)
    never = SolverSettings(sleep_frames=0)
    x = predict_fold(mesh, mesh.lay_flat(material.thickness), material, towel_half(), RELEASE, 4.0, never).vertices
    s = ClothSimulation(mesh, material, x, never)
    s.advance(120)
    return s


@pytest.mark.parametrize("axis", [0, 1])
def test_those_who_stay_awake_do_not_feel_that_others_fell_asleep(at_rest, axis):
    """Half of a folded towel falls asleep; of the rest, which has a part of the crease, none moves by 0.1 mm."""
    s = ClothSimulation(at_rest.mesh, at_rest.material, settings=at_rest.settings)
    s.restore(at_rest.checkpoint())
    before = s.positions
    asleep = before[:, axis] < np.median(before[:, axis])
    s._state.awake[asleep], s._state.wa[asleep] = False, 0.0
    s._state.v[asleep] = 0.0
    s._state.counts[PACKED] = 0
    s.advance(60)
    moved = 1e3 * np.linalg.norm(s.positions - before, axis=1)
    assert not moved[asleep].any()
    assert moved[~asleep].max() < 0.1


@pytest.mark.parametrize("start", range(4))
def test_a_large_towel_is_at_rest_a_second_after_its_release(start):
    """From starts that differ by 1e-6 m: while sleepers held their neighbours up, creases beside them began to
    swing each time some fell asleep, and two of three such folds still moved by 0.5 to 2.7 mm in 0.1 s."""
    mesh, material, folds = planned_folds("large_towel")
    x = mesh.lay_flat(material.thickness)
    x += (start > 0) * 1e-6 * np.random.default_rng(start).standard_normal(x.shape)
    shots = list(frames_of(mesh, x, material, folds[0]))
    rate = SolverSettings().frame_rate
    last = len(shots) - round((RELEASE + SETTLE) * rate) + rate - 1
    assert np.linalg.norm(shots[last] - shots[last - 6], axis=1).max() < 5e-4


def test_the_fourth_column_stays_zero_through_a_fold():
    mesh, material = towel_mesh(425)
    s = ClothSimulation(mesh, material)
    x = mesh.lay_flat(material.thickness)
    down = np.diag([1.0, -1.0, -1.0])
    assert s.grip(0, x[np.argmax(x @ [1.0, 1.0, 0.0])], down).layers
    position, rotation = np.zeros((61, 2, 3)), np.tile(down, (61, 2, 1, 1))
    position[:, 0] = s._tool_p[0] + np.linspace(0.0, 1.0, 61)[:, None] * [-0.3, 0.0, 0.1]
    rods = np.tile([[-0.2, -0.3, 0.01]], (61, 1, 1)), np.tile([[-0.2, 0.3, 0.01]], (61, 1, 1))
    rods[0][:, 0, 0] += np.linspace(0.0, 0.05, 61)
    s.advance_along(position, rotation, (*rods, np.array([0.01])))
    state, pairs = s._state, s._pairs
    assert np.abs(state.x[:, :3]).max() < 2.0 and pairs.act_n.any()
    for rows in (state.x, state.xp, state.v, state.u, state.press, pairs.vt_j, pairs.ee_j, pairs.normal,
                 pairs.act_n, pairs.act_m, pairs.act_j, pairs.act_p):  # fmt: skip
        assert not rows[:, 3].any()


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 1.0])
def test_packed_is_what_has_a_free_end_with_its_shares(share):
    """Free is what is awake, and two rings about it but what is fixed; shares are the closed form's, with the mass
    of a neighbour that sleeps."""
    mesh = mesh_from_contour(np.array([[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [-0.2, 0.15]]), 0.025)
    rng = np.random.default_rng(4)
    n = len(mesh.rest)
    s = ClothSimulation(mesh, MATERIAL, fixed=rng.random(n) < 0.1)
    body, state, w = s._body, s._state, s._body.w
    state.awake[:] = (rng.random(n) < share) & (w > 0.0)
    pack(body, state)
    near = state.awake.copy()
    for _ in range(2):
        near[mesh.edges[near[mesh.edges].any(axis=1)]] = True
    free = np.where(near, w, 0.0)
    awake, movable = state.counts[AWAKE], state.counts[MOVABLE]
    assert set(state.awake_list[:awake].tolist()) == set(np.flatnonzero(state.awake).tolist())
    assert sorted(state.awake_list[:movable].tolist()) == np.flatnonzero(free > 0.0).tolist()
    h = s._rules.h
    elastic = build_elastic(mesh, MATERIAL, 1.0 / (MATERIAL.areal_mass * mesh.vertex_area), h, 0.6)
    asked = (free[elastic.edge] > 0.0).any(axis=1)
    edges, grow = state.counts[EDGES], 1.0 + s._rules.bend_gamma
    np.testing.assert_array_equal(state.edge[:edges], elastic.edge[asked])
    np.testing.assert_allclose(state.inverse_square[:edges] * elastic.length[asked] ** 2, 1.0)
    inverse = 1.0 / (w[elastic.edge].sum(axis=1) + elastic.compliance / h**2)
    shares = (free[elastic.edge] * inverse[:, None])[asked]
    np.testing.assert_allclose(np.column_stack([state.wi[:edges], state.wj[:edges]]), shares)
    asked = (free[elastic.hinge] > 0.0).any(axis=1)
    hinges, k = state.counts[HINGES], elastic.weight
    np.testing.assert_array_equal(state.hinge[:hinges], elastic.hinge[asked])
    np.testing.assert_array_equal(state.which[:hinges], np.flatnonzero(asked))
    inverse = grow / (grow * (w[elastic.hinge] * k**2).sum(axis=1) + elastic.bend / h**2)
    np.testing.assert_allclose(state.part[:hinges], (free[elastic.hinge] * k * inverse[:, None])[asked])
