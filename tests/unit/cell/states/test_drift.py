"""Drift of the garment moves the assumed shape and the plan."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.states.stages import Plan
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.vocabulary import FoldLine, FoldStep, Grasp, GraspId


@pytest.mark.parametrize("turn", [-0.1, 0.0, 0.07])
def test_drift_moves_the_whole_plan_with_the_outline(turn: float) -> None:
    """The drift is about a point far from the middle of the vertices, as with a sleeve that is folded over."""
    rng = np.random.default_rng(3)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    t, middle = np.array([0.012, -0.004]), np.array([0.9, 0.3])
    vertices, rest = rng.uniform(0.3, 0.7, (40, 3)), rng.uniform(0.3, 0.7, (40, 2))
    point, line = np.array([0.5, 0.1]), FoldLine(np.array([0.6, 0.0]), np.array([0.0, 1.0]))
    grasp = Grasp(point, 0.2, 2, 0.004)
    step = FoldStep("hem", 0, line, (line,), {GraspId.LEFT: grasp}, {GraspId.LEFT: np.array([0.7, 0.1, 0.01])})
    one = np.array([[0, 1, 2]], np.int32)
    mesh = ClothMesh(rest, np.zeros(40, np.int32), one, np.zeros(1, np.int32), np.zeros((0, 2), np.int32))
    seen: Any = SimpleNamespace(drift=R @ middle + t - middle, drift_rad=turn, drift_about=middle)

    towel = load_garment("medium_towel")
    flat = towel.flat_state(*towel.poses.middle)
    after = Plan(towel, towel, flat, (step,), mesh, vertices).drifted(seen)

    def moved(xy: np.ndarray) -> np.ndarray:
        return xy @ R.T + t

    np.testing.assert_allclose(after.vertices[:, :2], moved(vertices[:, :2]), atol=1e-12)
    np.testing.assert_array_equal(after.vertices[:, 2], vertices[:, 2])
    np.testing.assert_allclose(after.mesh.rest, moved(rest), atol=1e-12)
    (there,) = after.steps
    np.testing.assert_allclose(there.grasps[GraspId.LEFT].point, moved(point), atol=1e-12)
    np.testing.assert_allclose(there.line.point, moved(line.point), atol=1e-12)
    np.testing.assert_allclose(there.line.direction, R @ line.direction, atol=1e-12)
    np.testing.assert_allclose(there.targets[GraspId.LEFT][:2], moved(np.array([0.7, 0.1])), atol=1e-12)


def test_a_plan_made_from_the_drifted_garment_equals_the_drifted_plan() -> None:
    towel = load_garment("medium_towel")
    flat = towel.flat_state(*towel.poses.middle)
    steps = plan_folds(flat, towel).unwrap()
    nothing = np.zeros((0, 2))
    mesh = ClothMesh(
        nothing,
        np.zeros(0, np.int32),
        np.zeros((0, 3), np.int32),
        np.zeros(0, np.int32),
        np.zeros((0, 2), np.int32),
    )
    plan = Plan(towel, towel, flat, steps, mesh, np.zeros((0, 3)))
    seen: Any = SimpleNamespace(drift=np.array([0.02, -0.01]), drift_rad=0.05, drift_about=np.array([0.6, 0.1]))
    after = plan.drifted(seen)
    for anew, moved in zip(plan_folds(after.flat, towel).unwrap(), after.steps, strict=True):
        assert set(anew.grasps) == set(moved.grasps) and anew.variant == moved.variant
        for i, grasp in anew.grasps.items():
            np.testing.assert_allclose(grasp.point, moved.grasps[i].point, atol=1e-12)
            np.testing.assert_allclose(anew.targets[i], moved.targets[i], atol=1e-12)
            assert np.cos(grasp.heading - moved.grasps[i].heading) == pytest.approx(1.0)
