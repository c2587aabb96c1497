"""Pinches and folds: the cloth has no crossings, is at rest and near the target."""

import numpy as np
import pytest

from benchmarks.cloth.scenes import IN, MATERIAL, TOWEL, arc
from foldcell.skills.cloth.intersections.crossings import count_crossings
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import GraspId
from tests.builders.cloth import straight

MESH = mesh_from_contour(TOWEL, 0.0262)
DOWN = np.diag([1.0, -1.0, -1.0])


def both(start, end, mirror, heading):
    """The same arc for both hands, mirrored in x (0) or y (1)."""
    flip = np.ones(3)
    flip[mirror] = -1.0
    return {
        GraspId.LEFT: arc(start, end, heading),
        GraspId.RIGHT: arc(start * flip, end * flip, heading),
    }


@pytest.fixture(scope="module")
def folded():
    paths = both(np.array([0.3 - IN, 0.2 - IN, 0.001]), np.array([-0.3 + IN, 0.2 - IN, 0.012]), 1, np.pi / 2)
    return predict_fold(MESH, MESH.lay_flat(0.003), MATERIAL, paths, keyframes=7)


def test_a_towel_folds_in_half(folded):
    x = folded.vertices
    flat = MESH.lay_flat(0.003)
    target = flat.copy()
    moving = flat[:, 0] > 0
    target[moving, 0] *= -1
    target[moving, 2] += 0.003
    assert count_crossings(x, MESH.triangles) == 0
    assert [count_crossings(k, MESH.triangles) for k in folded.keyframes] == [0] * 7
    assert folded.residual_motion < 5e-4
    assert np.linalg.norm(x - target, axis=1).mean() < 0.006
    assert np.linalg.norm((x - flat)[flat[:, 0] < -0.05], axis=1).max() < 0.005
    assert not folded.dropped


def test_a_towel_folds_in_quarters(folded):
    left = arc([-0.28 + IN, 0.2 - IN, 0.0005], [-0.28 + IN, -0.2 + IN, 0.02], 0.0)
    right = arc([-0.06, 0.2 - IN, 0.0005], [-0.06, -0.2 + IN, 0.02], 0.0)
    r = predict_fold(MESH, folded.vertices, MATERIAL, {GraspId.LEFT: left, GraspId.RIGHT: right})
    assert {p.layers for p in r.pinches.values()} == {2}
    assert count_crossings(r.vertices, MESH.triangles) == 0
    assert r.residual_motion < 1e-3
    assert r.vertices[:, 2].max() < 0.07
    # four layers cover a quarter of the towel, and no cloth lies outside by more than the crease's bulge
    assert r.vertices[:, 1].max() < 0.04 and r.vertices[:, 1].min() > -0.24


def test_a_pinch_grasps_the_layers_within_its_height(folded):
    s = ClothSimulation(MESH, MATERIAL, folded.vertices)
    at = np.array([-0.2, 0.15])
    near = np.linalg.norm(s.positions[:, :2] - at, axis=1) < 0.03
    top = s.positions[near, 2].max()
    assert s.grip(0, np.array([*at, 0.0]), DOWN).layers == 2
    assert s.grip(0, np.array([*at, 0.5 * (0.0015 + top) + 0.0015]), DOWN).layers == 1
    assert s.grip(0, np.array([*at, 0.03]), DOWN).held_points == 0
    assert s.grip(0, np.array([0.5, 0.15, 0.0]), DOWN).held_points == 0


def test_held_cloth_hangs_from_the_held_line_with_its_weight():
    s = ClothSimulation(MESH, MATERIAL, settings=SolverSettings(drag=3.0, sleep_frames=0))
    p = np.array([0.3 - IN, 0.0, 0.001])
    s.grip(0, p, np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]))
    up = p + np.array([0.0, 0.0, 0.9])
    r = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    s.advance_along(*straight(120, [p, p], [up, up], r))
    s.advance(120)
    assert s.positions[:, 2].min() > 0.0
    force = s.pinch_force(0)
    assert force[2] == pytest.approx(-0.4 * 0.24 * 9.81, rel=0.01)
    assert np.abs(force[:2]).max() < 0.05
    held = np.argmin(np.linalg.norm(MESH.rest - [0.3 - IN, 0.0], axis=1))
    assert np.linalg.norm(s.positions[held] - up) < 0.03
    s.release(0)
    s.advance(60)
    assert s.positions[:, 2].max() < 0.7


def test_a_pinch_releases_cloth_above_its_holding_force():
    """Two pads with friction mu bear 2 mu N. A weak grip loses the towel during the lift, and a firm grip does
    not."""
    weight = 0.4 * 0.24 * 9.81
    pads = PadGeometry(friction=0.8)
    held = []
    for force in (0.8 * weight / 1.6, 1.5 * weight / 1.6):
        s = ClothSimulation(MESH, MATERIAL, pads=pads)
        p = np.array([0.0, 0.0, 0.001])
        s.grip(1, p, DOWN, force=force)
        s.advance_along(*straight(120, [p, p], [[0.0, 0.0, 0.801]] * 2, DOWN))
        held.append(s.held(1))
    assert held == [False, True]


def test_a_sleeve_of_a_two_layer_shirt_folds():
    outline = np.array(
        [(-0.2, -0.25), (0.2, -0.25), (0.2, 0.1), (0.42, 0.02), (0.45, 0.1), (0.18, 0.24), (-0.2, 0.24)]
    )
    mesh = mesh_from_contour(outline, 0.028, layers=2)
    s = ClothSimulation(mesh, MATERIAL)
    s.advance(30)
    assert count_crossings(s.positions, mesh.triangles) == 0
    paths = {GraspId.LEFT: arc([0.42, 0.07, 0.0005], [-0.02, 0.07, 0.02], np.pi / 2)}
    r = predict_fold(mesh, s.positions, MATERIAL, paths, keyframes=7)
    assert r.pinches[GraspId.LEFT].layers == 2
    assert count_crossings(r.vertices, mesh.triangles) == 0
    assert max(count_crossings(k, mesh.triangles) for k in r.keyframes) <= 5
    assert r.vertices[:, 0].max() < 0.3  # the sleeve lies on the body


def test_crossings_of_two_sheets_are_counted():
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [5, 5, 1.0]])
    tri = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    assert count_crossings(x, tri) == 2  # one edge of each sheet passes through the other
    x[3:, :2] += 3.0
    assert count_crossings(x, tri) == 0
