"""A corner of the upper layer that lies turned back, in heights that are drawn from polygons with noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.perception.scenes import TABLE
from foldcell.cell.hardware.camera import nominal_calibration
from foldcell.robots.baxter.robot import MOUNT
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.perception.inspection.predicted_view import outline_of
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.state_estimate.comparison import fit
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState, Hypothesis
from foldcell.skills.state_estimate.observation import Observation
from foldcell.skills.state_estimate.turned_corner import with_turned_corner
from foldcell.skills.state_estimate.wording import describe
from foldcell.skills.vocabulary import FoldLine, Grasp, GraspId, PredictedShape

VIEW = TableView(nominal_calibration(MOUNT, TABLE), TABLE)
HALF = FoldLine(np.array([0.6, 0.0]), np.array([1.0, 0.0]))
"""The left half of a towel, 0.3 m deep, was folded onto the right half."""
CORNERS = np.array([[0.45, -0.3], [0.75, -0.3], [0.75, 0.0], [0.45, 0.0]])
TIP = CORNERS[1]
NOISE, LIFT = 0.001, 0.002
"""Standard deviation of a pixel's height, and height by which the camera sees everything too high [m]."""


def filled(*corners: Array) -> Array:
    image = np.zeros(VIEW.shape, np.uint8)
    cv2.fillPoly(image, [np.round(VIEW.to_pixel(np.array(corners))).astype(np.int32)], 1)
    return image.astype(bool)


def crease_of(inward: float, along: float) -> tuple[FoldLine, tuple[Array, Array]]:
    """The crease of the turned corner, and its ends on both edges."""
    ends = TIP - np.array([inward, 0.0]), TIP + np.array([0.0, along])
    return FoldLine(ends[0], (ends[1] - ends[0]) / np.hypot(inward, along)), ends


def estimated(
    turned: tuple[float, float] | None, thickness: float, layers: int = 2, seed: int = 0
) -> StateEstimate:
    """The estimate of a towel whose upper corner lies in its place, or is turned back. turned: distances from its
    tip to the crease along both edges [m]."""
    mask = filled(*CORNERS)
    height = np.full(VIEW.shape, np.nan)
    height[mask] = 2.0
    if turned is not None:
        crease, ends = crease_of(*turned)
        height[filled(TIP, *ends)] = 1.0
        height[filled(crease.reflect(TIP), *ends)] = 4.0  # the turned cloth is lofty
        height[filled(*ends) & mask] = np.nan
    noise = NOISE * np.random.default_rng(seed).standard_normal(VIEW.shape)
    seen = Observation(VIEW, mask, (height * thickness + LIFT + noise).astype(np.float32),
                       outline_of(VIEW, mask), np.zeros((*VIEW.shape, 3), np.uint8))  # fmt: skip
    flat = np.vstack([CORNERS[:2], HALF.reflect(CORNERS[1::-1])])
    mesh = mesh_from_contour(flat, 0.02)
    upper = HALF.signed_distance(mesh.rest) > 0.0
    vertices = np.column_stack([fold_xy((HALF,), mesh.rest), (0.5 + upper) * thickness])
    shape = PredictedShape(frozen(vertices), mesh.triangles, mesh.rest)
    best = fit(seen, Hypothesis(FoldState.BEFORE, shape))
    probabilities = dict.fromkeys(FoldState, 0.01) | {FoldState.BEFORE: 0.97}
    found = StateEstimate(FoldState.BEFORE, 0.97, best, probabilities, (best,), 0, seen.contour)
    grasps = {
        GraspId.LEFT: Grasp(np.array([0.738, -0.012]), np.pi / 2, layers, 2 * thickness),
        GraspId.RIGHT: Grasp(TIP + np.array([-0.012, 0.012]), np.pi / 2, layers, 2 * thickness),
    }
    return with_turned_corner(found, seen, grasps, thickness)


@pytest.mark.parametrize("turned", [(0.08, 0.12), (0.06, 0.06)])
def test_a_turned_corner_is_found_where_it_lies(turned: tuple[float, float]) -> None:
    found = estimated(turned, 0.0027)
    assert found.state is FoldState.HALF_WAY and found.confidence == found.probabilities[found.state] == 0.97
    assert "turned back at the right grasp" in describe(found)
    assert found.best is not None and found.condensed().best is found.best
    shape = found.best.shape
    place = np.linalg.norm(shape.material - HALF.reflect(TIP), axis=1).argmin()
    expected = crease_of(*turned)[0].reflect(TIP)
    assert np.linalg.norm(shape.vertices[place, :2] - expected) < 0.012
    assert shape.vertices[place, 2] == pytest.approx(2.5 * 0.0027)
    below = np.linalg.norm(shape.material - TIP, axis=1).argmin()
    assert np.linalg.norm(shape.vertices[below, :2] - TIP) < 0.004, "the lower layer has stayed"


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("thickness", [0.0012, 0.0027])
def test_a_corner_in_its_place_is_not_taken_for_turned(thickness: float, seed: int) -> None:
    assert estimated(None, thickness, seed=seed).state is FoldState.BEFORE


def test_neither_a_step_below_the_noise_of_the_camera_nor_a_single_layer_is_judged() -> None:
    assert estimated((0.08, 0.12), 0.0012).state is FoldState.BEFORE
    assert estimated((0.08, 0.12), 0.0027, layers=1).state is FoldState.BEFORE
