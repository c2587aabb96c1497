"""The cloth protocol of the simulated cell, with foldcell's solver and with MuJoCo's flex."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.simulation import SimulationSettings, check_settings
from foldcell.cell.simulation.garment.cloth_body import FRAME_RATE, BodyTraits, ClothBody, build_body, check_body
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.garment.pressing import tip_pressure
from foldcell.cell.simulation.noise import load_noise
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array
from foldcell.skills.cloth.elasticity import GRAVITY
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.vocabulary import Material
from tests.optional_parts import MUJOCO

MATERIAL = Material(0.4, 0.02, 0.015, 0.003, 0.6, 0.55, 0.5)
MESH = mesh_from_contour(np.array([[-0.06, -0.04], [0.06, -0.04], [0.06, 0.04], [-0.06, 0.04]]), 0.02)
WEIGHT = MATERIAL.areal_mass * 0.12 * 0.08 * GRAVITY
DOWN = np.diag([1.0, -1.0, -1.0])
EDGE = np.array([0.0, 0.035, 0.0])
"""The middle of the side at +y. The line between the pads is along x."""


@pytest.fixture(params=["xpbd", "mujoco"])
def world(request: pytest.FixtureRequest) -> str:
    if request.param == "mujoco":
        MUJOCO.require()
    return str(request.param)


def body(world: str) -> ClothBody:
    flat = MESH.lay_flat(MATERIAL.thickness)
    return build_body(world, MESH, MATERIAL, flat, BodyTraits(), PadGeometry())


def above(point: Array, height: float) -> Array:
    return np.asarray(point + np.array([0.0, 0.0, height]))


def lead(cloth: ClothBody, start: Array, end: Array, seconds: float) -> None:
    """Move hand 0 from start to end, pointing down, with minimum jerk."""
    n = round(seconds * FRAME_RATE)
    s = np.linspace(0.0, 1.0, n + 1)
    path = start + np.outer(s**3 * (10 - 15 * s + 6 * s * s), end - start)
    position = np.stack((path, np.zeros_like(path)), axis=1)
    cloth.advance_along(position, np.tile(DOWN, (n + 1, 2, 1, 1)))


def lifted(world: str) -> ClothBody:
    cloth = body(world)
    cloth.grip(0, EDGE, DOWN, 20.0)
    lead(cloth, EDGE, above(EDGE, 0.2), 0.6)
    cloth.advance(60)
    return cloth


def test_cloth_at_rest_does_not_move(world: str) -> None:
    cloth = body(world)
    before = cloth.positions
    cloth.advance(60)
    assert np.abs(cloth.positions - before).max() < 3e-4
    assert not cloth.held(0)


def test_cloth_between_the_pads_hangs_from_the_hand(world: str) -> None:
    cloth = lifted(world)
    assert cloth.held(0) and not cloth.held(1)
    top = cloth.positions[:, 2].max()
    assert top == pytest.approx(0.2, abs=0.012)  # the hem beyond the held line stands up
    assert cloth.positions[:, 2].min() == pytest.approx(0.125, abs=0.015)
    assert cloth.pinch_force(0)[2] == pytest.approx(-WEIGHT, rel=0.15)  # the cloth swings a little


def test_cloth_falls_from_open_pads(world: str) -> None:
    cloth = lifted(world)
    cloth.release(0)
    cloth.advance(60)
    assert not cloth.held(0)
    assert cloth.positions[:, 2].max() < 0.08
    assert cloth.positions[:, 2].min() > 0.0


def test_pads_that_close_beside_the_cloth_hold_nothing(world: str) -> None:
    cloth = body(world)
    report = cloth.grip(0, EDGE + np.array([0.0, 0.06, 0.0]), DOWN, 20.0)
    assert report.held_points == report.layers == 0
    assert not cloth.held(0)
    assert cloth.grip(0, EDGE, DOWN, 20.0).layers == 1


def test_cloth_slips_out_of_pads_with_too_little_force(world: str) -> None:
    cloth = lifted(world)
    cloth.set_grip_force(0, 0.3 * WEIGHT / (2.0 * cloth.pads.friction))
    cloth.advance(3)
    assert not cloth.held(0)


def test_a_hand_pushes_the_cloth(world: str) -> None:
    """A finger that sweeps through the hanging cloth takes it along, and the holding hand feels the force."""
    cloth = lifted(world)
    n, radius = 45, 0.010
    y = np.linspace(-0.05, 0.065, n + 1)
    low = np.stack((np.full(n + 1, -0.05), y, np.full(n + 1, 0.15)), axis=1)[:, None, :]
    high = low + np.array([0.10, 0.0, 0.0])
    held = np.zeros((n + 1, 2, 3)) + above(EDGE, 0.2)
    cloth.advance_along(held, np.tile(DOWN, (n + 1, 2, 1, 1)), (low, high, np.array([radius])))
    x = cloth.positions
    assert x[np.abs(x[:, 2] - 0.15) < 0.012, 1].min() > 0.065
    assert np.linalg.norm(x[:, 1:] - [0.065, 0.15], axis=1).min() > 0.8 * radius
    assert cloth.pinch_force(0)[1] > 0.02 * WEIGHT


def test_a_restored_checkpoint_continues_bit_for_bit(world: str) -> None:
    cloth = body(world)
    cloth.grip(0, EDGE, DOWN, 20.0)
    lead(cloth, EDGE, above(EDGE, 0.1), 0.3)
    saved = cloth.checkpoint()
    other = body(world)
    other.restore(saved)
    for one in (cloth, other):
        lead(one, above(EDGE, 0.1), EDGE, 0.2)
    assert cloth.positions.tobytes() == other.positions.tobytes()
    assert cloth.held(0) and other.held(0)


def test_a_world_refuses_unsupported_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match="one layer"):
        check_settings(SimulationSettings(garment="pants", world="mujoco"))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ConfigurationError) as caught:
        check_settings(SimulationSettings(garment="small_towel", world="mujoco"))
    assert "peers" in caught.value.hint
    check_body("xpbd", "pants", 2)


def test_a_run_in_an_impossible_world_is_refused_before_it_begins(tmp_path: Path) -> None:
    assert main(["fold", "pants", "--world", "mujoco", "--logs", str(tmp_path)]) == 64
    assert not list(tmp_path.rglob("journal.db"))


def test_the_anisotropy_of_a_garment_changes_how_its_cloth_hangs() -> None:
    """Cloth that is stiffer along material y hangs shorter by its y side."""
    soft = replace(MATERIAL, stretch_fraction=0.1)
    drops = []
    for anisotropy in (1.0, 4.0):
        cloth = build_body(
            "xpbd", MESH, soft, MESH.lay_flat(0.003), BodyTraits(anisotropy=anisotropy), PadGeometry()
        )
        side = np.array([0.0, 0.035, 0.0])
        cloth.grip(0, side, DOWN, 20.0)
        lead(cloth, side, above(side, 0.2), 0.6)
        cloth.advance(60)
        drops.append(np.ptp(cloth.positions[:, 2]))
    assert drops[1] < drops[0]


def test_the_bending_friction_of_a_garment_keeps_a_part_of_a_wave() -> None:
    """A wave pressed into the cloth remains in part. Without friction it disappears."""
    wave = MESH.lay_flat(0.003)
    wave[:, 2] += 0.006 * (1.0 + np.cos(2.0 * np.pi * wave[:, 0] / 0.06))
    heights = []
    for residual in (0.0, 44.0):
        cloth = build_body("xpbd", MESH, MATERIAL, wave, BodyTraits(residual_curvature=residual), PadGeometry())
        cloth.advance(60)
        heights.append(np.ptp(cloth.positions[:, 2]))
    assert heights[0] < 1e-4 and heights[1] > 3e-4


def test_each_garment_has_its_own_bending_friction_and_set_and_an_ideal_one_has_none() -> None:
    noise, towel = load_noise().garment, load_garment("small_towel")
    drawn = [WorldGarment(towel, noise, np.random.default_rng(seed), ideal=False).traits for seed in range(20)]
    residual, sets, times = np.array([(t.residual_curvature, t.crease_set, t.crease_time) for t in drawn]).T
    assert len(set(residual)) == len(set(sets)) == len(set(times)) == 20
    assert np.abs(residual / noise.residual_curvature - 1.0).max() <= noise.residual_curvature_spread
    assert np.abs(sets / towel.material.crease_set - 1.0).max() <= noise.crease_set
    assert noise.crease_time.low <= times.min() < 1.0 < times.max() <= noise.crease_time.high
    ideal = WorldGarment(towel, noise, np.random.default_rng(0), ideal=True).traits
    assert ideal.residual_curvature == ideal.crease_set == 0.0


@pytest.mark.parametrize("edge", [0.008, 0.015, 0.022])
def test_the_pressure_of_a_fingertip_adds_up_to_its_force_on_any_mesh(edge: float) -> None:
    mesh = mesh_from_contour(np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]), edge)
    x = np.column_stack([mesh.rest, np.full(len(mesh.rest), 0.001)])
    rng = np.random.default_rng(1)
    forces = []
    for at in rng.uniform(-0.04, 0.04, (40, 2)):
        pressure = tip_pressure(x, np.array([[*at, 0.002]]), np.array([10.0]), 1e-4, edge)
        forces.append(pressure @ mesh.vertex_area)
    assert np.mean(forces) == pytest.approx(10.0, rel=0.1) and min(forces) > 5.0
    assert not tip_pressure(x, np.array([[0.0, 0.0, -0.05]]), np.array([10.0]), 1e-4, edge).any()


def test_a_fingertip_sets_the_crease_that_it_presses_and_a_longer_one_more() -> None:
    fold = MESH.lay_flat(0.003)
    fold[:, 0] = np.where(fold[:, 0] > 0.0, -fold[:, 0], fold[:, 0])
    fold[:, 2] += np.where(MESH.rest[:, 0] > 0.0, 0.003, 0.0)
    kept = []
    for frames in (0, 15, 60):
        cloth = build_body(
            "xpbd", MESH, MATERIAL, fold, BodyTraits(residual_curvature=44.0, crease_set=0.55), PadGeometry()
        )
        tips = np.array([[-0.004, 0.0, 0.003]])
        cloth.press(tip_pressure(cloth.positions, tips, np.array([20.0]), 1e-4, 0.012))
        for _ in range(frames):
            cloth.advance()
        kept.append(float(np.abs(cloth.checkpoint()["state.set_parts"]).sum()))
    assert kept[0] == 0.0 < 1.5 * kept[1] < kept[2]
