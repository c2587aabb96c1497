"""Judges whether a segmented region can be a garment that lies alone, flat and wholly in view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skills.perception.garment_height import upper_height
from skills.perception.rectification.table_view import TableView
from skills.perception.segmentation.mask import Segmentation
from skills.perception.segmentation.obstruction import obstruction_failure
from skills.perception.settings import PerceptionSettings
from skills.vocabulary import Failure, FailureKind

__all__ = ["touches_border", "unusable"]


def unusable(
    segmentation: Segmentation, view: TableView, height: NDArray[np.float32], settings: PerceptionSettings
) -> Failure | None:
    if not segmentation.found:
        return Failure(
            FailureKind.NO_GARMENT, "no garment is visible on the table", "lay one flat in the camera's view"
        )
    margin = max(round(settings.border / view.pixel), 1)
    if (failure := _not_alone(segmentation, view, margin, settings)) is not None:
        return failure
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
    top = upper_height(segmentation.mask, height)
    if top > settings.flat_height:
        return Failure(
            FailureKind.NOT_FLAT,
            f"the garment reaches {top * 1e3:.0f} mm above the table",
            "spread it flat",
            {"height_m": top},
        )
    return None


def _not_alone(
    segmentation: Segmentation, view: TableView, margin: int, settings: PerceptionSettings
) -> Failure | None:
    """Return UNKNOWN_GARMENT for a second garment, VIEW_OBSTRUCTED for something flat that reaches into the
    picture, else None."""
    share = np.count_nonzero(segmentation.others) / np.count_nonzero(segmentation.mask)
    values = {"other_area_share": float(share)}
    if share > settings.intruder and touches_border(segmentation.others, view.valid, margin):
        return obstruction_failure(view, segmentation.others, "something flat", values)
    if share <= settings.litter:
        return None
    return Failure(
        FailureKind.UNKNOWN_GARMENT, "more than one thing lies on the table",
        "leave a single garment on the table", values,
    )  # fmt: skip


def touches_border(mask: NDArray[np.bool_], valid: NDArray[np.bool_], margin: int) -> bool:
    """Whether a region comes within `margin` pixels of the border of the valid view."""
    size = 2 * margin + 1
    inner = cv2.erode(valid.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0
    return bool((mask & ~inner).any())
