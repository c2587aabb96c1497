"""Judges whether a segmented region can be a garment that lies alone, flat and wholly in view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skills.perception.rectification.heights import smooth_height, upper
from skills.perception.rectification.table_view import TableView
from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.obstruction import obstruction_failure
from skills.perception.settings import PerceptionSettings
from skills.vocabulary import Failure, FailureKind

__all__ = ["intrusion", "touches_border", "unusable"]


def unusable(
    segmentation: Segmentation, view: TableView, height: NDArray[np.float32], settings: PerceptionSettings
) -> Failure | None:
    """Return the reason why a region cannot be the garment, else None. height: (H, W) above the table [m]."""
    if not segmentation.found:
        return Failure(
            FailureKind.NO_GARMENT, "no garment is visible on the table", "lay one flat in the camera's view"
        )
    margin = max(round(settings.border / view.pixel), 1)
    if (failure := intrusion(segmentation, view, margin, settings)) is not None:
        return failure
    if segmentation.others_share > settings.litter:
        return Failure(
            FailureKind.UNKNOWN_GARMENT,
            "more than one thing lies on the table",
            "leave a single garment on the table",
            {"other_area_share": segmentation.others_share},
        )
    if segmentation.confidence < settings.lowest_segmentation:
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"only {segmentation.confidence:.0%} of the garment's boundary is clearly visible",
            "the fabric has the table's colour, or the light changed: take a new picture of the empty table",
            {"segmentation_confidence": segmentation.confidence},
        )
    if touches_border(segmentation.mask, view.valid, margin):
        return Failure(
            FailureKind.OUT_OF_VIEW,
            "the garment extends beyond the camera's view or the table's edge",
            "lay it nearer to the middle of the table",
        )
    smooth = smooth_height(height)
    top = upper(smooth[segmentation.mask & np.isfinite(smooth)])
    if top > settings.flat_height:
        return Failure(
            FailureKind.NOT_FLAT,
            f"the garment reaches {top * 1e3:.0f} mm above the table",
            "spread it flat",
            {"height_m": top},
        )
    return None


def intrusion(
    segmentation: Segmentation, view: TableView, margin: int, settings: PerceptionSettings
) -> Failure | None:
    """Return VIEW_OBSTRUCTED if something flat beside the garment reaches into the picture, to within `margin`
    pixels of the border, else None."""
    share = segmentation.others_share
    if share <= settings.intruder or not touches_border(segmentation.others, view.valid, margin):
        return None
    return obstruction_failure(view, segmentation.others, "something flat", {"other_area_share": share})


def touches_border(mask: NDArray[np.bool_], valid: NDArray[np.bool_], margin: int) -> bool:
    """Whether a region comes within `margin` pixels of the border of the valid view."""
    size = 2 * margin + 1
    inner = cv2.erode(valid.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0
    return bool((mask & ~inner).any())
