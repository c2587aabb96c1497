"""The figures of an inspection: heights compared with the prediction, to find piled cloth and missing layers, and
how far the garment still reaches beyond the fold line."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE
from foldcell.skills.perception.inspection.result import FOLD_MARGIN
from foldcell.skills.perception.rectification.heights import LOFTY, upper
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import FoldStep, GraspId

STRIP_HALF_WIDTH = 0.06
"""Half the width of the strips in which `left_behind` and `sag` are measured: one strip at each grasp, and one
between two grasps."""
MIN_LAYER_HEIGHT = 0.0018
"""Minimum predicted height at a target. If it is lower, missing layers are not judged there, because depth
cannot resolve so little."""


def judged_area(mask: NDArray[np.bool_], view: TableView, step: FoldStep | None) -> NDArray[np.bool_]:
    """Return the part (H, W) of a mask in which heights are judged: away from its rim and from the fold lines."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    if step is not None:
        rows, columns = np.nonzero(inner)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        near = np.zeros(len(xy), bool)
        for line in step.lines:
            near |= np.abs(line.signed_distance(xy)) < FOLD_MARGIN
        inner[rows[near], columns[near]] = False
    return inner


def upper_height(height: NDArray[np.float32], judged: NDArray[np.bool_]) -> float:
    """95th percentile of the heights (H, W) in the judged area [m]; NaN if too little of it is visible."""
    return upper(height[judged & np.isfinite(height)])


def extra_height(excess: NDArray[np.float32], judged: NDArray[np.bool_]) -> float:
    """95th percentile of the excess height (H, W) over a prediction in the judged area [m]; 0 if too little of it
    is visible."""
    return float(np.nan_to_num(upper_height(excess, judged)))


def piled_area(excess: NDArray[np.float32], judged: NDArray[np.bool_], threshold: float, pixel: float) -> float:
    """Part of the judged area in which the excess height (H, W) [m] is above the threshold [m], in [m2]. pixel:
    edge of a pixel [m]."""
    return float(np.count_nonzero((excess > threshold) & judged)) * pixel**2


def missing_layer(
    height: NDArray[np.float32],
    moved: NDArray[np.float32],
    view: TableView,
    step: FoldStep | None,
    R: Array,
    t: Array,
    raised: float = 0.0,
) -> float:
    """Return the missing share (0..1) of the predicted height at the worst target; NaN if no target can be judged.

    Measured and predicted mean height are compared over a patch around each target, if enough cloth is predicted
    there. A predicted ruck counts as no more than a lofty stack of the layers at the target: the garment may lie
    flatter than predicted. height: (H, W) measured [m]. moved: (H, W) predicted height [m] after the rigid motion
    R (2, 2), t (2,) [m]. raised: height by which the prediction was raised above its mesh [m].
    """
    if step is None:
        return float("nan")
    shares = []
    rows, columns = np.nonzero(np.isfinite(moved) & np.isfinite(height))
    if not len(rows):
        return float("nan")
    xy = view.to_table(np.stack([columns, rows], axis=1))
    predicted, measured = moved[rows, columns], height[rows, columns]
    for grasp_id, target in step.targets.items():
        patch = np.linalg.norm(xy - (R @ target[:2] + t), axis=1) < 0.04
        if np.count_nonzero(patch) < 300:
            continue
        planned = float(np.minimum(predicted[patch], _lofty(step, grasp_id, raised)).mean())
        if planned >= MIN_LAYER_HEIGHT:
            shares.append(1.0 - float(measured[patch].mean()) / planned)
    return max(shares) if shares else float("nan")


def _lofty(step: FoldStep, grasp_id: GraspId, raised: float) -> float:
    """Return the height of a lofty stack of the layers at a target [m]: those below it and the grasped ones."""
    grasp = step.grasps.get(grasp_id)
    if grasp is None:
        return float("inf")
    below = max(float(step.targets[grasp_id][2]) - RELEASE_CLEARANCE, 0.0)
    return LOFTY * (below + grasp.height + raised)


def left_behind(
    view: TableView, mask: NDArray[np.bool_], predicted: NDArray[np.bool_], step: FoldStep | None
) -> Mapping[str, float]:
    """Measure how much further than predicted the garment reaches beyond the fold line [m], on the side from which
    it was folded.

    mask, predicted: (H, W) observed and predicted silhouette. The result's keys are the grasps, and 'middle' for
    the place between two grasps; a value is NaN if too little is visible there. Empty without a step.
    """
    if step is None or not step.grasps:
        return {}
    line = step.line
    places = {str(i): float((g.point - line.point) @ line.direction) for i, g in step.grasps.items()}
    if len(places) == 2:
        places["middle"] = sum(places.values()) / 2
    coordinates = []
    for region in (mask, predicted):
        rows, columns = np.nonzero(region)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        coordinates.append(((xy - line.point) @ line.direction, line.signed_distance(xy)))
    excess = {}
    for name, place in places.items():
        seen, planned = (across[np.abs(along - place) < STRIP_HALF_WIDTH] for along, across in coordinates)
        enough = min(len(seen), len(planned)) > 50
        excess[name] = float(np.quantile(seen, 0.98) - np.quantile(planned, 0.98)) if enough else float("nan")
    return excess
