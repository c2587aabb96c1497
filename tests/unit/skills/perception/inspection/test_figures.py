"""Heights of a folded garment: where they are judged, and excess and missing height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE
from foldcell.skills.perception.inspection.diagnosis import MAX_MISSING
from foldcell.skills.perception.inspection.figures import (
    MIN_LAYER_HEIGHT,
    extra_height,
    judged_area,
    missing_layer,
    piled_area,
    upper_height,
)
from foldcell.skills.perception.inspection.result import FOLD_MARGIN
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.plane import rotation
from foldcell.skills.vocabulary import Array, FoldLine, FoldStep, Grasp, GraspId
from tests.inspections import on_table
from tests.scenes import TABLE, camera

VIEW = TableView(camera(), TABLE)
HERE = on_table(VIEW)
"""(H, W, 2) position of each pixel on the table [m]."""
LAYER = 0.003
LEFT, RIGHT = np.array([0.55, 0.15]), np.array([0.55, -0.15])
ACROSS = FoldLine(np.array([0.7, 0.0]), np.array([0.0, 1.0]))
ALONG = FoldLine(np.array([0.6, 0.1]), np.array([1.0, 0.0]))
STEP = FoldStep("half", 0, ACROSS, (), {}, {GraspId.LEFT: np.r_[LEFT, 0.01], GraspId.RIGHT: np.r_[RIGHT, 0.01]})
STILL = np.eye(2), np.zeros(2)


def within(x: tuple[float, float], y: tuple[float, float]) -> Array:
    return (HERE[..., 0] > x[0]) & (HERE[..., 0] < x[1]) & (HERE[..., 1] > y[0]) & (HERE[..., 1] < y[1])


STACK = within((0.45, 0.75), (-0.25, 0.25))


@pytest.mark.parametrize("lines", [(), (ACROSS,), (ALONG, ACROSS)])
def test_heights_are_judged_away_from_the_rim_and_from_every_fold_line(lines: tuple[FoldLine, ...]) -> None:
    """Heights are judged from 40 mm on both sides of each fold line, also of earlier folds, and from 3 pixels
    inside the rim."""
    step = replace(STEP, earlier=lines[:-1], line=lines[-1]) if lines else None
    judged = judged_area(STACK, VIEW, step)
    inner = within((0.457, 0.743), (-0.243, 0.243))
    for line in lines:
        inner = inner & (np.abs(line.signed_distance(HERE)) > FOLD_MARGIN)
    rim = within((0.4545, 0.7455), (-0.2455, 0.2455))
    assert judged[inner].all(), "all inner pixels are judged"
    assert not (judged & ~rim).any()
    for line in lines:
        assert not (judged & (np.abs(line.signed_distance(HERE)) < FOLD_MARGIN - 1e-9)).any()


def test_the_stack_height_is_the_95th_percentile() -> None:
    rng = np.random.default_rng(0)
    height = rng.permutation(np.linspace(0.0, 1.0, STACK.size)).reshape(STACK.shape).astype(np.float32)
    judged = np.ones(STACK.shape, bool)
    assert upper_height(height, judged) == pytest.approx(0.95, abs=1e-4)
    height[STACK] = np.nan  # unseen pixels
    assert upper_height(height, judged) == pytest.approx(0.95, abs=0.01)
    height[~STACK] = 0.5
    height[STACK] = 7.0  # pixels that are not judged
    assert upper_height(height, ~STACK) == extra_height(height, ~STACK) == pytest.approx(0.5)


def test_too_few_seen_pixels_give_no_excess_height() -> None:
    few = np.zeros(STACK.shape, bool)
    few[:10, :10] = True
    excess = np.full(STACK.shape, 0.05, np.float32)
    assert np.isnan(upper_height(excess, few)) and extra_height(excess, few) == 0.0
    few[10, 0] = True
    assert extra_height(excess, few) == pytest.approx(0.05)


def test_the_piled_area_is_the_area_above_the_height_limit() -> None:
    """A heap of 30 by 40 mm on a stack, seen with pixels of 2 mm. Then a part of the heap is not judged, or not
    seen."""
    excess = np.zeros(VIEW.shape, np.float32)
    heap = within((0.600, 0.630), (0.0, 0.040))
    excess[heap] = 0.016
    assert piled_area(excess, STACK, 0.015, VIEW.pixel) == pytest.approx(0.030 * 0.040)
    assert piled_area(excess, STACK, 0.017, VIEW.pixel) == 0.0
    assert piled_area(excess, STACK & ~within((0.0, 0.610), (-1, 1)), 0.015, VIEW.pixel) == pytest.approx(0.0008)
    excess[~STACK] = 0.1
    excess[within((0.600, 0.630), (0.020, 0.040))] = np.nan
    assert piled_area(excess, STACK, 0.015, VIEW.pixel) == pytest.approx(0.030 * 0.020)


def lacking(
    left: float,
    right: float,
    planned: float = 2 * LAYER,
    step: FoldStep | None = STEP,
    hidden: Array | None = None,
) -> float:
    """The missing layer if these shares of the predicted height are missing on the table's left and right half."""
    moved = np.where(STACK, planned, np.nan).astype(np.float32)
    height = np.where(HERE[..., 1] > 0, 1.0 - left, 1.0 - right).astype(np.float32) * np.float32(planned)
    if hidden is not None:
        height[hidden] = np.nan
    return missing_layer(height, moved, VIEW, step, *STILL)


@pytest.mark.parametrize(("left", "right"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.3, 0.6), (-0.2, -0.4)])
def test_the_missing_layer_is_that_of_the_target_with_the_most_missing_height(left: float, right: float) -> None:
    assert lacking(left, right) == pytest.approx(max(left, right), abs=1e-5)


def test_heights_at_a_target_are_measured_at_the_observed_place_of_the_fold() -> None:
    """The whole garment was turned and moved, so the targets moved too."""
    R, t = rotation(np.deg2rad(30.0)), np.array([0.35, -0.28])
    moved = np.full(VIEW.shape, 2 * LAYER, np.float32)
    height = moved.copy()
    height[np.linalg.norm(HERE - (R @ LEFT + t), axis=2) < 0.04] = LAYER
    assert missing_layer(height, moved, VIEW, STEP, R, t) == pytest.approx(0.5, abs=0.01)
    assert missing_layer(height, moved, VIEW, STEP, *STILL) < 0.2


def test_a_predicted_ruck_that_is_not_there_is_no_missing_layer() -> None:
    """The stack of two layers lies flat, where a ruck of ten layers' height was predicted."""
    grasps = {i: Grasp(target[:2], 0.0, 1, LAYER) for i, target in STEP.targets.items()}
    targets = {i: np.r_[target[:2], LAYER + RELEASE_CLEARANCE] for i, target in STEP.targets.items()}
    step = replace(STEP, grasps=grasps, targets=targets)
    flat = np.where(STACK, 2 * LAYER, np.nan).astype(np.float32)
    ruck = flat.copy()
    ruck[np.linalg.norm(HERE - LEFT, axis=2) < 0.03] = 10 * LAYER
    assert missing_layer(flat, ruck, VIEW, step, *STILL) < MAX_MISSING
    assert missing_layer(0.5 * flat, ruck, VIEW, step, *STILL) > MAX_MISSING, "one layer is missing"


def test_an_unseen_target_is_ignored() -> None:
    """Less than a quarter of the circle of 40 mm around one target is seen. The other target still counts."""
    near = np.linalg.norm(HERE - LEFT, axis=2)
    assert lacking(0.5, 0.1, hidden=near < 0.05) == pytest.approx(0.1, abs=1e-5)
    assert lacking(0.5, 0.1, hidden=near < 0.037) == pytest.approx(0.1, abs=1e-5)
    assert lacking(0.5, 0.1, hidden=near < 0.03) == pytest.approx(0.5, abs=1e-5)
    assert np.isnan(lacking(0.5, 0.1, hidden=np.ones(VIEW.shape, bool)))
    assert np.isnan(lacking(0.5, 0.1, step=None)) and np.isnan(lacking(0.5, 0.1, step=replace(STEP, targets={})))


def test_the_missing_layer_uses_the_mean_height_of_a_stepped_target() -> None:
    """Two layers are planned on one half of the target and six on the other. Half of each is present."""
    moved = np.where(HERE[..., 0] > LEFT[0], 2 * LAYER, 6 * LAYER).astype(np.float32)
    assert missing_layer(0.5 * moved, moved, VIEW, STEP, *STILL) == pytest.approx(0.5, abs=1e-5)
    level = np.full_like(moved, 4 * LAYER)
    assert missing_layer(level, moved, VIEW, STEP, *STILL) == pytest.approx(0.0, abs=0.05)


def test_layers_too_thin_for_the_depth_camera_are_not_reported_as_missing() -> None:
    assert np.isnan(lacking(0.9, 0.9, planned=0.98 * MIN_LAYER_HEIGHT))
    assert lacking(0.9, 0.9, planned=1.02 * MIN_LAYER_HEIGHT) == pytest.approx(0.9, abs=1e-4)
