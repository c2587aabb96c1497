"""The solver against closed forms and conservation laws."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.cloth.scenes import MATERIAL, stacked
from foldcell.robots.errors import ConfigurationError, InternalError
from foldcell.skills.cloth.elasticity import GRAVITY, colour_batches, damp_edges, shuffled, solve_edges
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.simd.aligned_arrays import aligned
from foldcell.skills.cloth.solver import ClothSimulation
from tests.builders.cloth import call, rows, straight, turned

PATCH = mesh_from_contour(np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]]), 0.026)
FREE = SolverSettings(gravity=(0.0, 0.0, 0.0), drag=0.0, sleep_frames=0)


def hung_strip(stretch, edge, substeps, length=0.6, width=0.15):
    """Elongation of a strip that hangs from its upper hem."""
    mesh = mesh_from_contour(np.array([[0, 0], [width, 0], [width, length], [0, length]]), edge)
    top, bottom = mesh.rest[:, 1] > length - 1e-9, mesh.rest[:, 1] < 1e-9
    x = np.column_stack([mesh.rest[:, 0], np.zeros(len(mesh.rest)), mesh.rest[:, 1]])
    settings = SolverSettings(substeps=substeps, drag=2.0, sleep_frames=0)
    s = ClothSimulation(mesh, replace(MATERIAL, stretch_fraction=stretch), x, settings, table=False, fixed=top)
    s.advance(200)
    z = s.positions[:, 2]
    return (z[top].mean() - z[bottom].mean()) / length - 1.0


@pytest.mark.parametrize(("stretch", "edge", "substeps"), [(0.01, 0.026, 20), (0.03, 0.026, 20), (0.03, 0.026, 40),
                                                           (0.03, 0.018, 20), (0.02, 0.03, 12)])  # fmt: skip
def test_a_hung_strip_elongates_by_its_stretch_fraction(stretch, edge, substeps):
    """The closed form of a strip under its own weight is areal_mass g L / (2 Y), for any mesh and any substeps."""
    assert hung_strip(stretch, edge, substeps) == pytest.approx(stretch, abs=1.2e-3)


@pytest.mark.parametrize(
    ("strain", "error"), [(0.03, 3e-4), (-0.03, 3e-4), (0.1, 3e-3), (-0.1, 3e-3), (-0.5, 0.2)]
)
def test_a_sweep_restores_the_length_of_an_edge(strain, error):
    """One stiff edge has ends of different mass. The remaining strain is at most `error`, and the centre of mass
    stays."""
    x, length, w = rows(2), 0.02, np.array([3.0, 1.0])
    along = np.array([2.0, -1.0, 2.0]) / 3.0
    x[0, :3] = 0.1, 0.2, 0.3
    x[1, :3] = x[0, :3] + (1.0 + strain) * length * along
    middle = x[0] / w[0] + x[1] / w[1]
    one, share = np.array([[0, 1]], np.uint32), w / w.sum()
    call(solve_edges, np.array([0, 1]), one, np.array([length**-2]), share[:1], share[1:], x)
    assert abs(np.linalg.norm(x[1] - x[0]) / length - 1.0) < error * abs(strain)
    assert x[0] / w[0] + x[1] / w[1] == pytest.approx(middle)


def test_an_edge_without_length_has_no_effect():
    x = rows(2)
    x[:, :3] = 1.0
    one, half = np.array([[0, 1]], np.uint32), np.full(1, 0.5)
    call(solve_edges, np.array([0, 1]), one, np.array([2500.0]), half, half, x)
    assert (x[:, :3] == 1.0).all()


def shuffled_edges(outline, edge):
    mesh = mesh_from_contour(outline, edge)
    return mesh.edges[shuffled(len(mesh.edges))], len(mesh.rest)


@pytest.mark.parametrize("size", [0.03, 0.1, 0.3])
def test_edges_of_one_colour_share_no_vertex_and_other_edges_keep_their_order(size):
    edge, n = shuffled_edges(size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), 0.025)
    order, bounds = colour_batches(edge)
    assert sorted(order.tolist()) == list(range(len(edge)))
    assert bounds[0] == 0 and bounds[-1] == len(edge)
    for first, end in pairwise(bounds):
        assert len(np.unique(edge[order[first:end]])) == 2 * (end - first) > 0
    for i in range(n):
        assert (np.diff(order[(edge[order] == i).any(axis=1)]) > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_edges_in_groups_of_four_give_the_same_bits_as_one_by_one(seed):
    """All bits are equal, except signs of zeros. Some vertices sleep, one is not finite, and some edges have no
    length."""
    edge, n = shuffled_edges(0.2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), 0.025)
    rng, m = np.random.default_rng(seed), len(edge)
    w = np.where(rng.random(n) < 0.4, 0.0, rng.uniform(500.0, 2000.0, n))
    square, wi, wj, rate = rng.uniform(1e3, 3e3, m), *rng.uniform(0.1, 0.5, (2, m)), rng.uniform(0.0, 0.4, m)
    place, speed = rows(n), rows(n)
    place[:, :3], speed[:, :3] = 0.03 * rng.standard_normal((n, 3)), rng.standard_normal((n, 3))
    for i, j in edge[: m // 10]:
        place[j] = place[i]
    place[edge[-1, 0], :3] = np.nan

    def swept(order, bounds):
        x, v, own = aligned(place), aligned(speed), edge[order].astype(np.uint32)
        call(damp_edges, bounds, own, rate[order], w, x, v)
        call(solve_edges, bounds, own, square[order], wi[order], wj[order], x)
        return x, v

    single, fours = swept(np.arange(m), np.arange(m + 1)), swept(*colour_batches(edge))
    np.testing.assert_array_equal(fours, single)
    assert (single[0] != place).any() and (single[1] != speed).any() and np.isnan(single).any()
    assert np.isfinite(single[1]).sum() > n


def slide(mu, angle, frames=60):
    settings = SolverSettings(gravity=(GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)), drag=0.0)
    s = ClothSimulation(PATCH, replace(MATERIAL, friction_static=mu, friction_dynamic=mu), settings=settings)
    start = s.positions
    s.advance(frames)
    return (s.positions - start)[:, 0]


@pytest.mark.parametrize("mu", [0.2, 0.6, 1.0])
def test_a_tilted_table_holds_cloth_below_the_friction_angle(mu):
    assert np.abs(slide(mu, np.arctan(0.98 * mu))).max() < 5e-5


@pytest.mark.parametrize("mu", [0.2, 0.6, 1.0])
@pytest.mark.parametrize("ratio", [1.02, 1.1, 1.5])
def test_cloth_slides_on_a_tilted_table_by_the_closed_form(mu, ratio):
    angle = np.arctan(ratio * mu)
    expected = 0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle))  # after one second
    assert slide(mu, angle) == pytest.approx(expected, rel=0.02)


def test_free_cloth_conserves_momentum():
    s = ClothSimulation(PATCH, MATERIAL, settings=FREE, table=False)
    rng = np.random.default_rng(3)
    x = s.positions + rng.normal(scale=2e-3, size=(len(PATCH.rest), 3))
    v = rng.normal(scale=0.3, size=x.shape)
    s.set_positions(x, v)
    mass = 1.0 / s._body.w[:, None]
    before = (mass * v).sum(axis=0)
    angular = (mass * np.cross(x, v)).sum(axis=0)
    s.advance(30)
    np.testing.assert_allclose((mass * s.velocities).sum(axis=0), before, atol=1e-9)
    # angular momentum is conserved to first order in the step
    after = (mass * np.cross(s.positions, s.velocities)).sum(axis=0)
    assert np.linalg.norm(after - angular) < 0.05 * (mass * np.linalg.norm(np.cross(x, v), axis=1)[:, None]).sum()


def test_the_energy_never_increases():
    s = ClothSimulation(PATCH, MATERIAL, settings=FREE, table=False)
    v = np.random.default_rng(5).normal(scale=0.5, size=(len(PATCH.rest), 3))
    s.set_positions(s.positions, v)
    mass = 1.0 / s._body.w
    kinetic = [0.5 * (mass * (v**2).sum(axis=1)).sum()]
    for _ in range(20):
        s.advance(3)
        kinetic.append(0.5 * (mass * (s.velocities**2).sum(axis=1)).sum())
    assert max(kinetic[1:]) < kinetic[0]
    assert kinetic[-1] < 0.5 * kinetic[0]


def test_flat_cloth_at_rest_stays_and_sleeps():
    s = ClothSimulation(PATCH, MATERIAL)
    start = s.positions
    s.advance(60)
    assert np.abs(s.positions - start).max() < 1e-5
    assert s.asleep.all()


def test_a_sheet_falls_freely_and_lands_on_the_table():
    settings = SolverSettings(drag=0.0)
    s = ClothSimulation(PATCH, MATERIAL, PATCH.lay_flat(0.003) + np.array([0, 0, 1.0]), settings)
    s.advance(24)
    t, h = 0.4, settings.frame / s.substeps
    assert s.positions[:, 2] == pytest.approx(1.0015 - 0.5 * GRAVITY * t * (t + h), abs=1e-6)
    s.advance(90)
    assert s.asleep.all()
    assert s.positions[:, 2].min() > 0.0014 and s.positions[:, 2].max() < 0.004


def test_a_sheet_dropped_on_another_does_not_pass_through():
    """Two separate layers: the upper one comes to rest one thickness above the lower one."""
    n = len(PATCH.rest)
    both = stacked([PATCH, turned(PATCH, 0.4)])
    x = both.lay_flat(0.003)
    x[n:, 2] += 0.15
    s = ClothSimulation(both, MATERIAL, x)
    s.advance(90)
    inner = np.abs(both.rest[n:]).max(axis=1) < 0.05
    assert s.positions[n:][inner, 2] == pytest.approx(0.0045, abs=4e-4)
    assert s.positions[:n, 2] == pytest.approx(0.0015, abs=2e-4)


def run_of(seed):
    s = ClothSimulation(PATCH, MATERIAL, PATCH.lay_flat(0.003) + np.array([0, 0, 0.05]))
    v = np.random.default_rng(seed).normal(scale=1.0, size=(len(PATCH.rest), 3))
    s.set_positions(s.positions, v)
    s.advance(40)
    return s


def test_results_are_bit_identical_in_another_thread_and_from_a_checkpoint():
    reference = run_of(1).positions
    with ThreadPoolExecutor(2) as pool:
        others = list(pool.map(run_of, [1, 2, 1]))
    assert others[0].positions.tobytes() == reference.tobytes() == others[2].positions.tobytes()
    assert others[1].positions.tobytes() != reference.tobytes()
    saved = others[0].checkpoint()
    others[0].advance(20)
    others[1].restore(saved)
    others[1].advance(20)
    assert others[1].positions.tobytes() == others[0].positions.tobytes()


@pytest.mark.parametrize("change", ["other", "older"])
def test_a_checkpoint_of_another_version_of_the_solver_is_refused_and_changes_nothing(change):
    s = run_of(1)
    before, saved = s.positions, run_of(2).checkpoint()
    if change == "other":
        saved["kernel"] = np.array("another")
    else:
        del saved["kernel"]
    with pytest.raises(ConfigurationError, match="another foldcell"):
        s.restore(saved)
    assert np.array_equal(s.positions, before)


def test_a_checkpoint_of_another_mesh_is_refused_and_changes_nothing():
    """The other mesh has as many vertices, but the compiled loop would write beyond the ends of its arrays."""
    square = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    fine, other = (mesh_from_contour(square, 0.025, rotate=turn) for turn in (0.0, 0.35))
    n = min(len(fine.rest), len(other.rest))
    s, t = ClothSimulation(fine, MATERIAL), ClothSimulation(other, MATERIAL)
    before, saved = s.positions, t.checkpoint()
    for name in ("x", "xp", "v", "u", "ref", "last"):
        saved[f"state.{name}"] = np.resize(saved[f"state.{name}"][:n], s.checkpoint()[f"state.{name}"].shape)
    with pytest.raises(InternalError, match="another mesh"):
        s.restore(saved)
    assert np.array_equal(s.positions, before)


def test_advancing_frame_by_frame_equals_advancing_all_frames_in_one_call():
    a, b = run_of(4), run_of(4)
    a.advance(12)
    for _ in range(12):
        b.advance(1)
    assert a.positions.tobytes() == b.positions.tobytes()


def jerked(frames, substeps=20, fails=lambda simulation: False):
    """A patch is lifted by two hands, one of which is then torn aside at 1.6 m/s for `frames` frames, with
    `substeps`. fails: of which simulations the positions are lost meanwhile."""
    down = np.diag([1.0, -1.0, -1.0])
    hands = [np.array([x, -0.09, 0.0015]) for x in (-0.14, 0.14)]
    s = ClothSimulation(PATCH, MATERIAL, settings=SolverSettings(substeps=20))
    for hand, place in enumerate(hands):
        s.grip(hand, place, down)

    def move(ways):
        after = [p + w / 60 for p, w in zip(hands, ways, strict=True)]
        s.advance_along(*straight(1, hands, after, down))
        hands[:] = after

    for _ in range(15):
        move([np.array([0.0, 0.0, 0.4])] * 2)
    lifted = s.checkpoint()
    s = ClothSimulation(PATCH, MATERIAL, settings=SolverSettings(substeps=substeps))
    s._continue_from(lifted)
    advanced = ClothSimulation._advanced

    def failing(simulation, *motion):
        good = advanced(simulation, *motion)
        if fails(simulation):
            simulation._state.x[:] = np.nan
        return good and not fails(simulation)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ClothSimulation, "_advanced", failing)
        for _ in range(frames):
            move([np.zeros(3), np.array([-0.5, 0.8, -1.3])])
    return s


@pytest.mark.parametrize("times", [2, 4])
def test_a_hasty_frame_in_which_positions_are_lost_is_repeated_with_shorter_substeps(times):
    """The cloth then moves as with such substeps from the first of these frames on, and both hands hold it."""
    s = jerked(4, fails=lambda simulation: simulation.substeps < 20 * times)
    sound = jerked(4, substeps=20 * times)
    assert s.substeps == 20
    assert s.time == sound.time
    assert s.held(0) and s.held(1)
    assert np.abs(s.positions - sound.positions).max() < 1e-6
    s.advance(30)
    assert np.isfinite(s.positions).all()


def test_a_finer_simulation_that_is_used_again_continues_as_a_new_one(monkeypatch):
    used, finer = jerked(4, fails=lambda simulation: simulation.substeps < 40), ClothSimulation._with_substeps
    assert len(used._finer) == 1

    def new(simulation, *about):
        simulation._finer.clear()
        return finer(simulation, *about)

    monkeypatch.setattr(ClothSimulation, "_with_substeps", new)
    built = jerked(4, fails=lambda simulation: simulation.substeps < 40).checkpoint()
    assert all(np.array_equal(value, built[name]) for name, value in used.checkpoint().items())


def test_sleeping_cloth_that_a_hand_tears_away_in_one_call_is_repeated_too():
    down, place = np.diag([1.0, -1.0, -1.0]), np.array([0.14, -0.09, 0.0015])
    s = ClothSimulation(PATCH, MATERIAL, settings=SolverSettings(substeps=20), at_rest=True)
    s.grip(1, place, down)
    way = place + np.outer(np.arange(6), [-0.5, 0.8, 1.3]) / 60
    with pytest.MonkeyPatch.context() as patch:
        coarse = ClothSimulation._advanced
        patch.setattr(ClothSimulation, "_advanced", lambda s, *m: s.substeps > 20 and coarse(s, *m))
        position = np.stack([np.zeros((6, 3)), way], axis=1)
        s.advance_along(position, np.broadcast_to(down, (6, 2, 3, 3)))
    assert s.held(1) and s.positions[:, 2].max() > 0.05


def test_positions_that_shorter_substeps_lose_as_well_are_an_error():
    with pytest.raises(InternalError, match="lost its positions"):
        jerked(1, fails=lambda simulation: True)


def test_a_finger_pushes_the_cloth():
    s = ClothSimulation(PATCH, MATERIAL)
    s.advance(30)
    assert s.asleep.all()
    shift = np.linspace(0.0, 1.0, 46)[:, None, None] * [0.15, 0.0, 0.0]
    s.advance(45, (np.array([-0.2, 0.0, 0.004]) + shift, np.array([-0.2, 0.0, 0.1]) + shift, np.array([0.01])))
    touched = (np.abs(PATCH.rest[:, 1]) < 0.02) & (PATCH.rest[:, 0] < -0.14)
    assert (s.positions - PATCH.lay_flat(0.003))[touched, 0].max() > 0.05
    assert np.isfinite(s.positions).all() and np.abs(s.velocities).max() < 4.0


@pytest.mark.parametrize(
    "change",
    [
        {"areal_mass": 0.0},
        {"stretch_fraction": -0.1},
        {"thickness": 3.0},
        {"friction_dynamic": 0.9},
        {"bending_length": np.nan},
    ],
)
def test_an_impossible_material_is_refused(change):
    with pytest.raises(ConfigurationError):
        ClothSimulation(PATCH, replace(MATERIAL, **change))
