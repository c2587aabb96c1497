"""Bending friction: the loop of the KES-F test, residual bending and conservation laws."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foldcell.robots.errors import ConfigurationError, InternalError
from foldcell.skills.cloth.elasticity import flexural_rigidity, turns
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Material

MATERIAL = Material(
    areal_mass=0.4, stretch_fraction=0.03, bending_length=0.02, thickness=0.001, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip
LENGTH, WIDTH = 0.06, 0.04
RESIDUAL = 30.0
VOID = (0.0, 0.0, 0.0)


def strip(edge):
    x, y = 0.5 * LENGTH, 0.5 * WIDTH
    return mesh_from_contour(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), edge)


def cylinder(mesh, curvature, direction=0.0):
    """(n, 3) the strip on a cylinder, bent along `direction` [rad]."""
    along = np.array([np.cos(direction), np.sin(direction)])
    across = np.array([-along[1], along[0]])
    s = mesh.rest @ along
    half = 0.5 * curvature * s
    sinc = np.sinc(half / np.pi)
    level = s * sinc * np.cos(half)
    return np.column_stack(
        [level[:, None] * along + (mesh.rest @ across)[:, None] * across, s * sinc * np.sin(half)]
    )


def moments(mesh, residual, curvatures, direction=0.0):
    """Moment over rigidity [1/m] of a strip that is moved from cylinder to cylinder. The moment follows by virtual
    work from the forces that accelerate the strip in a fifth of a millisecond."""
    settings = SolverSettings(
        frame_rate=5000, substeps=4, gravity=VOID, drag=0.0, stretch_damping=0.0, bend_damping=0.0,
        residual_curvature=residual,
    )  # fmt: skip
    s = ClothSimulation(mesh, MATERIAL, cylinder(mesh, 0.0), settings, table=False)
    found = []
    for k in curvatures:
        s.set_positions(cylinder(mesh, k, direction))
        s.advance()
        force = s.velocities / s._body.w[:, None] * settings.frame_rate
        way = (cylinder(mesh, k + 1e-3, direction) - cylinder(mesh, k - 1e-3, direction)) / 2e-3
        found.append(-(force * way).sum() / (mesh.area.sum() * flexural_rigidity(MATERIAL)))
    return np.array(found)


def led(*corners, step=2.0):
    """Curvatures in even steps through these values."""
    way = [np.arange(a, b, np.sign(b - a) * step) for a, b in pairwise(corners)]
    return np.concatenate([*way, [corners[-1]]])


@pytest.mark.parametrize(("edge", "direction"), [(0.012, 0.0), (0.012, np.pi / 2), (0.008, 0.5)])
def test_the_height_of_the_moment_loop_agrees_with_the_residual_curvature(edge, direction):
    """The loop's height at zero curvature is 2 HB, for any mesh and direction. Without friction there is no
    loop."""
    mesh, way = strip(edge), led(0.0, 40.0, -40.0, 40.0)
    _, down, up = np.flatnonzero(way == 0.0)
    plain = moments(mesh, 0.0, way, direction)
    slope = (plain[up + 1] - plain[up - 1]) / (way[up + 1] - way[up - 1])  # there are no hinges along the rim
    assert plain[up] == pytest.approx(plain[down], abs=0.01)
    rubbed = moments(mesh, RESIDUAL, way, direction)
    assert 0.5 * (rubbed[up] - rubbed[down]) / slope == pytest.approx(RESIDUAL, rel=0.08)
    # the loop is as high where the strip is bent
    assert rubbed[-1] - plain[-1] == pytest.approx(RESIDUAL * slope, rel=0.1)
    # the friction sticks at first
    assert 0.5 * (rubbed[1] + rubbed[2]) == pytest.approx(5.0 * slope * 3.0, rel=0.1)


@pytest.mark.parametrize(("bent", "left"), [(0.2, 0.0), (1.0, -1.0)])
def test_a_small_bend_is_elastic(bent, left):
    """Below a quarter of the residual curvature the sliders stick, so the strip returns to its first state."""
    mesh = strip(0.012)
    way = led(0.0, bent * RESIDUAL, 0.0, step=1.0)
    moment = moments(mesh, RESIDUAL, way)
    assert moment[-1] == pytest.approx(left * RESIDUAL * 0.86, abs=0.05 * RESIDUAL)


def curvature(mesh, x):
    """Curvature of the circle through the middles of the sides [1/m]."""
    at = np.array([-0.5 * LENGTH, 0.0, 0.5 * LENGTH])
    side = np.abs(mesh.rest[:, 1]) > 0.5 * WIDTH - 1e-6
    total = []
    for sign in (-1, 1):
        edge = side & (mesh.rest[:, 1] * sign > 0)
        edge = np.flatnonzero(edge)[np.argsort(mesh.rest[edge, 0])]
        total.append([[np.interp(s, mesh.rest[edge, 0], x[edge, m]) for m in range(3)] for s in at])
    a, b, c = np.mean(total, axis=0)
    sides = np.linalg.norm(b - a) * np.linalg.norm(c - b) * np.linalg.norm(a - c)
    return 2.0 * np.linalg.norm(np.cross(b - a, c - a)) / sides


def let_go(mesh, residual, bent, frames=60):
    settings = SolverSettings(gravity=VOID, drag=60.0, sleep_frames=0, residual_curvature=residual)
    s = ClothSimulation(mesh, MATERIAL, cylinder(mesh, 0.0), settings, table=False)
    s.set_positions(cylinder(mesh, bent))
    s.advance(frames)
    return s


@pytest.mark.parametrize("edge", [0.010, 0.0075])
def test_released_cloth_stays_bent(edge):
    mesh = strip(edge)
    assert curvature(mesh, cylinder(mesh, 25.0)) == pytest.approx(25.0, rel=0.1)
    stays = curvature(mesh, let_go(mesh, RESIDUAL, 60.0).positions)
    assert 0.85 * RESIDUAL < stays < 1.03 * RESIDUAL
    assert curvature(mesh, let_go(mesh, 0.0, 60.0).positions) < 0.02 * RESIDUAL
    assert curvature(mesh, let_go(mesh, RESIDUAL, 0.2 * RESIDUAL).positions) < 0.05 * RESIDUAL


def test_bending_friction_only_removes_energy_and_conserves_momentum():
    mesh = strip(0.010)
    rng = np.random.default_rng(5)
    v = rng.normal(scale=0.05, size=(len(mesh.rest), 3)) + np.cross([3.0, 8.0, 2.0], cylinder(mesh, 0.0))
    v[:, 2] += 1.0 * np.cos(2.0 * np.pi * mesh.rest[:, 0] / LENGTH)
    after = []
    for residual in (0.0, RESIDUAL):
        settings = SolverSettings(
            gravity=VOID, drag=0.0, sleep_frames=0, stretch_damping=0.0, bend_damping=0.0,
            residual_curvature=residual,
        )  # fmt: skip
        s = ClothSimulation(mesh, MATERIAL, cylinder(mesh, 0.0), settings, table=False)
        mass = 1.0 / s._body.w[:, None]
        s.set_positions(s.positions, v)
        spin = (mass * np.cross(s.positions, v)).sum(axis=0)
        energy = [(mass * v**2).sum()]
        for _ in range(20):
            s.advance(1)
            energy.append((mass * s.velocities**2).sum())
        assert max(energy[1:]) < energy[0]
        np.testing.assert_allclose((mass * s.velocities).sum(axis=0), (mass * v).sum(axis=0), atol=1e-9)
        kept = (mass * np.cross(s.positions, s.velocities)).sum(axis=0)
        after.append((energy[-1], np.linalg.norm(kept - spin) / np.linalg.norm(spin)))
    assert after[1][0] < 0.8 * after[0][0]
    assert after[1][1] < max(0.02, 1.2 * after[0][1])


def test_cloth_that_stays_bent_hardly_moves_by_itself():
    """Hinges and sliders pull against each other permanently. One sweep over both leaves a torque, which must be a
    thousandth of the effect of gravity on such a strip (about 500 rad/s2)."""
    mesh = strip(0.010)
    settings = SolverSettings(gravity=VOID, drag=0.0, sleep_frames=0, residual_curvature=RESIDUAL)
    s = ClothSimulation(mesh, MATERIAL, settings=settings, table=False)
    s.restore(let_go(mesh, RESIDUAL, 60.0).checkpoint())
    s.set_positions(s.positions)
    before = s.positions
    s.advance(60)
    after, mass = s.positions, 1.0 / s._body.w[:, None]
    np.testing.assert_allclose((mass * (after - before)).sum(axis=0), 0.0, atol=1e-12)
    spin = np.linalg.norm((mass * np.cross(after - after.mean(axis=0), s.velocities)).sum(axis=0))
    assert spin < 0.5 * mass.sum() * LENGTH**2 / 12.0
    assert curvature(mesh, after) == pytest.approx(curvature(mesh, before), rel=0.01)


def test_turning_bent_cloth_as_a_whole_does_not_change_its_moments():
    mesh = strip(0.010)
    s = let_go(mesh, RESIDUAL, 60.0, frames=3)
    turn = Rotation.from_euler("YX", [0.7, 2.0]).as_matrix()
    x, v, saved = s.positions, s.velocities, s.checkpoint()
    runs = []
    for rotation in (np.eye(3), turn):
        s.restore(saved)
        s.set_positions(x @ rotation.T, v @ rotation.T)
        s.advance(3)
        runs.append(s.positions @ rotation)
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-9)
    # bent from the flat state, not back from a bend
    fresh = ClothSimulation(mesh, MATERIAL, x, s.settings, table=False)
    fresh.set_positions(x, v)
    fresh.advance(3)
    assert np.abs(fresh.positions - runs[0]).max() > 1e-4


def test_checkpoints_include_the_state_of_the_sliders():
    mesh = strip(0.012)
    settings = SolverSettings(residual_curvature=RESIDUAL)
    x = cylinder(mesh, 50.0) + np.array([0.0, 0.0, 0.01])
    one, two = ClothSimulation(mesh, MATERIAL, x, settings), ClothSimulation(mesh, MATERIAL, settings=settings)
    one.advance(7)
    saved = one.checkpoint()
    two.restore(saved)
    for s in (one, two):
        s.advance(60)  # the strip falls asleep
    assert one.positions.tobytes() == two.positions.tobytes()
    slip = saved["state.slip"]
    assert np.abs(slip).max() > 0.05
    with pytest.raises(InternalError, match="friction"):
        ClothSimulation(mesh, MATERIAL).restore(saved)


def test_cloth_known_to_be_at_rest_has_no_bending_friction():
    mesh = strip(0.012)
    x = cylinder(mesh, 20.0) + np.array([0.0, 0.0, 0.01])
    settings = SolverSettings(residual_curvature=RESIDUAL)
    rest = ClothSimulation(mesh, MATERIAL, x, settings, at_rest=True)
    rest.advance(2)
    assert rest.positions.tobytes() == x.tobytes()
    bent = turns(mesh.hinges, x)
    np.testing.assert_array_equal(np.sort(rest.checkpoint()["state.slip"]), np.sort(bent))
    assert bent.max() == pytest.approx(20.0 * 0.010, rel=0.3)
    np.testing.assert_allclose(turns(mesh.hinges, x * [1.0, 1.0, -1.0]), -bent, atol=1e-12)


@pytest.mark.parametrize("residual", [-1.0, 2000.0, np.nan])
def test_impossible_bending_friction_is_refused(residual):
    with pytest.raises(ConfigurationError, match="residual_curvature"):
        ClothSimulation(strip(0.012), MATERIAL, settings=SolverSettings(residual_curvature=residual))
