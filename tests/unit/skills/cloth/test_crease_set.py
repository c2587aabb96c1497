"""Plastic set of pressed creases: its law, its shape after release, and the state that goes with it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foldcell.robots.errors import ConfigurationError, InternalError
from foldcell.skills.cloth.crease_set import (
    STANDARD_PRESSURE,
    STANDARD_TIME,
    YIELD_CURVATURE,
    largest_crease_set,
    set_share,
)
from foldcell.skills.cloth.elasticity import turns
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Material
from tests.builders.cloth import crease_angles

MATERIAL = Material(
    areal_mass=0.2, stretch_fraction=0.02, bending_length=0.02, thickness=0.001, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip
SET = 0.5
VOID = (0.0, 0.0, 0.0)
CURVATURE = 120.0


def strip(edge=0.010):
    return mesh_from_contour(np.array([[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]]), edge)


def cylinder(mesh, curvature):
    """(n, 3) the strip on a cylinder."""
    angle = curvature * mesh.rest[:, 0]
    height = 0.03 + (1.0 - np.cos(angle)) / curvature
    return np.column_stack([np.sin(angle) / curvature, mesh.rest[:, 1], height])


def simulation(mesh, x=None, residual=0.0, crease_set=SET, **more):
    settings = SolverSettings(
        gravity=VOID, drag=20.0, sleep_frames=0, residual_curvature=residual, crease_set=crease_set, **more
    )
    return ClothSimulation(mesh, MATERIAL, x, settings, table=False)


def angles(mesh, x):
    """(h,) signed angle of each hinge."""
    return 2.0 * np.arcsin(0.5 * turns(mesh.hinges, x))


def pressed(mesh, x, pressure, *times, **more):
    s = simulation(mesh, x, **more)
    s.press(pressure)
    for seconds in times:
        s.dwell(seconds)
    return s


def test_the_standard_load_sets_the_given_share_of_the_bend_beyond_the_yield():
    mesh = strip()
    x = cylinder(mesh, CURVATURE)
    bent = angles(mesh, x)
    found = crease_angles(pressed(mesh, x, STANDARD_PRESSURE, STANDARD_TIME))
    assert np.all(np.abs(found) <= SET * np.abs(bent) + 1e-12) and np.all(found * bent >= 0.0)
    # hinges that lie across the bend turn less than those along it, so that more of their turn stays elastic
    share = np.sum(np.abs(found) * np.abs(bent)) / np.sum(bent**2)
    assert share == pytest.approx(SET * (1.0 - YIELD_CURVATURE / CURVATURE), rel=0.3)
    mild = cylinder(mesh, 0.4 * YIELD_CURVATURE)
    assert not crease_angles(pressed(mesh, mild, STANDARD_PRESSURE, STANDARD_TIME)).any()


def test_steps_of_any_length_give_the_same_set_and_pressure_acts_as_a_clock():
    mesh = strip()
    x = cylinder(mesh, CURVATURE)
    whole = crease_angles(pressed(mesh, x, STANDARD_PRESSURE, 30.0))
    np.testing.assert_allclose(crease_angles(pressed(mesh, x, STANDARD_PRESSURE, *[0.5] * 60)), whole, rtol=1e-5)
    np.testing.assert_allclose(crease_angles(pressed(mesh, x, 2.0 * STANDARD_PRESSURE, 15.0)), whole, rtol=1e-9)
    np.testing.assert_allclose(
        whole,
        crease_angles(pressed(mesh, x, STANDARD_PRESSURE, 300.0)) * set_share(30.0, 1.0) / set_share(300.0, 1.0),
    )
    steps = np.diff([set_share(t, 1.0) for t in (1.0, 10.0, 100.0, 1000.0)])
    assert steps == pytest.approx(steps.mean(), rel=0.1)  # linear in the logarithm of time


def test_creases_take_no_set_without_a_load_or_under_the_weight_of_cloth():
    mesh = strip()
    x = cylinder(mesh, CURVATURE)
    for pressure in (0.0, 8 * 0.4 * 9.81):
        assert not crease_angles(pressed(mesh, x, pressure, 3600.0)).any()


def test_a_crease_that_is_pressed_flat_loses_its_set():
    mesh = strip()
    s = pressed(mesh, cylinder(mesh, CURVATURE), STANDARD_PRESSURE, STANDARD_TIME)
    before = np.abs(crease_angles(s)).sum()
    s.set_positions(cylinder(mesh, 1e-6))
    s.dwell(STANDARD_TIME)
    grown = 1.0 - np.exp(-STANDARD_TIME / np.array([1.0, 10.0, 100.0, 1000.0]))  # each part then decays as it grew
    left = np.sum(grown * (1.0 - grown)) / np.sum(grown)
    assert np.abs(crease_angles(s)).sum() == pytest.approx(left * before, rel=1e-6) and left < 0.1


@pytest.mark.parametrize("edge", [0.010, 0.0075])
def test_released_cloth_takes_the_shape_of_its_set(edge):
    mesh = strip(edge)
    s = pressed(mesh, cylinder(mesh, CURVATURE), STANDARD_PRESSURE, STANDARD_TIME)
    s.press(0.0)
    s.advance(90)
    bent, rest = angles(mesh, s.positions), crease_angles(s)
    assert np.abs(s.velocities).max() < 0.01
    assert np.sum(bent * rest) / np.sum(rest**2) == pytest.approx(1.0, abs=0.15)
    s.advance(60)
    np.testing.assert_allclose(angles(mesh, s.positions), bent, atol=0.02)  # stays so
    flat = simulation(mesh, cylinder(mesh, CURVATURE))
    flat.advance(90)
    assert np.abs(angles(mesh, flat.positions)).max() < 0.05


def test_a_set_crease_flings_the_cloth_neither_along_nor_around():
    """Momentum is conserved exactly, and angular momentum as well as without set."""
    mesh = strip()
    spins = []
    for load in (0.0, STANDARD_PRESSURE):
        s = pressed(mesh, cylinder(mesh, CURVATURE), load, STANDARD_TIME, residual=30.0)
        s.press(0.0)
        mass, before = 1.0 / s._body.w[:, None], s.positions
        s.advance(6)
        np.testing.assert_allclose((mass * (s.positions - before)).sum(axis=0), 0.0, atol=1e-9)
        x, v = s.positions - s.positions.mean(axis=0), s.velocities
        spins.append(np.linalg.norm((mass * np.cross(x, v)).sum(axis=0)) / (mass * np.abs(v)).sum() / 0.03)
    assert spins[1] < max(0.02, 2.0 * spins[0])


def test_turning_creased_cloth_as_a_whole_does_not_change_its_motion():
    mesh = strip()
    s = pressed(mesh, cylinder(mesh, CURVATURE), STANDARD_PRESSURE, 30.0, residual=30.0)
    s.press(0.0)
    s.advance(3)
    x, v, saved = s.positions, s.velocities, s.checkpoint()
    turn = Rotation.from_euler("YX", [0.7, 2.0]).as_matrix()
    runs = []
    for rotation in (np.eye(3), turn):
        s.restore(saved)
        s.set_positions(x @ rotation.T, v @ rotation.T)
        s.advance(3)
        runs.append(s.positions @ rotation)
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-9)


def test_a_hinge_that_is_pressed_past_180_degrees_keeps_its_side():
    rest = np.array([[0.0, -0.01], [0.0, 0.01], [0.02, 0.0], [-0.02, 0.0]])
    mesh = ClothMesh(
        rest, np.zeros(4, np.int32), np.array([[0, 2, 1], [0, 1, 3]], np.int32), np.zeros(2, np.int32),
        np.zeros((0, 2), np.int32),
    )  # fmt: skip

    def bent(degrees):
        a = np.radians(degrees)
        x = np.column_stack([rest, np.full(4, 0.02)])
        x[2] += [0.02 * (np.cos(a) - 1.0), 0.0, 0.02 * np.sin(a)]
        return x

    s = simulation(mesh, bent(100.0), frame_rate=2000, substeps=4)
    s.advance()
    s.set_positions(bent(186.0))
    s.press(STANDARD_PRESSURE)
    s.advance()
    s.dwell(STANDARD_TIME)
    away = simulation(mesh, bent(170.0))
    away.press(STANDARD_PRESSURE)
    away.dwell(STANDARD_TIME)
    ((over,), (under,)) = crease_angles(s), crease_angles(away)
    assert over * under > 0.0 and abs(over) > abs(under)


def test_checkpoints_include_the_set():
    mesh = strip()
    one, two = simulation(mesh, cylinder(mesh, CURVATURE), 30.0), simulation(mesh, residual=30.0)
    one.press(STANDARD_PRESSURE)
    one.advance(5)
    two.restore(one.checkpoint())
    for s in (one, two):
        s.advance(20)
    assert one.positions.tobytes() == two.positions.tobytes()
    assert crease_angles(one).tobytes() == crease_angles(two).tobytes() and crease_angles(one).any()
    with pytest.raises(InternalError):
        simulation(mesh, residual=30.0, crease_set=0.0).restore(one.checkpoint())


def test_without_crease_set_pressing_changes_nothing():
    mesh = strip()
    one, two = (simulation(mesh, cylinder(mesh, CURVATURE), 30.0, crease_set=0.0) for _ in range(2))
    two.press(STANDARD_PRESSURE)
    two.dwell(STANDARD_TIME)
    for s in (one, two):
        s.advance(10)
    assert one.positions.tobytes() == two.positions.tobytes() and not crease_angles(two).any()


def test_before_any_load_bending_friction_acts_as_without_set():
    mesh = strip()
    ends = []
    for crease_set in (0.0, SET):
        s = simulation(mesh, None, 30.0, crease_set)
        s.set_positions(cylinder(mesh, 60.0))
        s.advance(60)
        ends.append(s.positions)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


@pytest.mark.parametrize(
    "values", [{"crease_set": -0.1}, {"crease_set": 0.9}, {"crease_set": np.nan}, {"crease_time": 0.0}]
)
def test_an_impossible_set_is_refused(values):
    assert 0.7 < largest_crease_set(1.0) < 0.9
    with pytest.raises(ConfigurationError, match="crease"):
        ClothSimulation(strip(), MATERIAL, settings=SolverSettings(**values))
