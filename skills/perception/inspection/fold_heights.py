"""Heights over a folded garment against the predicted ones: cloth heaped up, and layers that are not there."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.inspection.result import InspectionSettings
from skills.perception.rectification.table_view import TableView
from skills.vocabulary import FoldStep

__all__ = ["extra_height", "judged_area", "missing_layer", "piled_area", "upper_height"]


def judged_area(
    mask: NDArray[np.bool_], view: TableView, step: FoldStep | None, settings: InspectionSettings
) -> NDArray[np.bool_]:
    """The part of a mask (H, W) away from its rim and from the fold lines: heights are judged there."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    if step is not None:
        rows, columns = np.nonzero(inner)
        xy = view.to_table(np.stack([columns, rows], axis=1))
        near = np.zeros(len(xy), bool)
        for line in step.lines:
            near |= np.abs(line.signed_distance(xy)) < settings.fold_margin
        inner[rows[near], columns[near]] = False
    return inner


def upper_height(height: NDArray[np.float32], judged: NDArray[np.bool_]) -> float:
    """95th percentile of the heights (H, W) [m] where they are judged; NaN where there is too little to see."""
    samples = height[judged & np.isfinite(height)]
    return float(np.quantile(samples, 0.95)) if len(samples) > 100 else float("nan")


def extra_height(excess: NDArray[np.float32], judged: NDArray[np.bool_]) -> float:
    """The same of the excess (H, W) [m] over a prediction; 0 where there is too little to see."""
    found = upper_height(excess, judged)
    return found if np.isfinite(found) else 0.0


def piled_area(excess: NDArray[np.float32], judged: NDArray[np.bool_], threshold: float, pixel: float) -> float:
    """Area over which the excess (H, W) [m] is more than the threshold [m2]. pixel: a pixel's edge [m]."""
    return float(np.count_nonzero((excess > threshold) & judged)) * pixel**2


def missing_layer(
    height: NDArray[np.float32],
    moved: NDArray[np.float32],
    view: TableView,
    step: FoldStep | None,
    R: Array,
    t: Array,
    settings: InspectionSettings,
) -> float:
    """How much of the upper layers that were to come to a target is not there (0..1), the worst target.

    Mean height over a patch inside each target, where the prediction has folded cloth, against prediction.
    """
    if step is None:
        return float("nan")
    shares = []
    rows, columns = np.nonzero(np.isfinite(moved) & np.isfinite(height))
    if not len(rows):
        return float("nan")
    xy = view.to_table(np.stack([columns, rows], axis=1))
    want, have = moved[rows, columns], height[rows, columns]
    for target in step.targets.values():
        patch = np.linalg.norm(xy - (R @ target[:2] + t), axis=1) < 0.04
        if np.count_nonzero(patch) < 300:
            continue
        planned = float(want[patch].mean())
        if planned >= settings.layer_height:
            shares.append(1.0 - float(have[patch].mean()) / planned)
    return max(shares) if shares else float("nan")
