"""Judges whether a segmented region can be a garment that lies alone, flat and wholly in view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.rectification.heights import smooth_height, upper
from foldcell.skills.perception.rectification.table_view import RectifiedView, TableView
from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.segmentation.obstruction import obstruction_failure
from foldcell.skills.perception.segmentation.surroundings import MOST_FOREIGN, foreign_stretch
from foldcell.skills.perception.settings import LITTER_SHARE, MIN_SEGMENTATION, VIEW_BORDER, PerceptionSettings
from foldcell.skills.vocabulary import Failure, FailureKind

__all__ = ["adjoined", "intrusion", "touches_border", "unusable"]

INTRUDER_SHARE = 0.02
"""Maximum area of objects that reach into the picture from its edge, relative to the area of the garment."""
RIVAL_SHARE = 0.5
"""Maximum area of other objects in a photograph of an unknown place, where other things lie, too."""


def unusable(
    segmentation: Segmentation,
    view: TableView,
    height: NDArray[np.float32],
    settings: PerceptionSettings,
    referenced: bool,
) -> Failure | None:
    """Return the reason why a region cannot be the garment, else None. height: (H, W) above the table [m].
    referenced: whether there is a picture of the empty table."""
    if not segmentation.found:
        return Failure(
            FailureKind.NO_GARMENT, "no garment is visible on the table", "lay one flat in the camera's view"
        )
    margin = max(round(VIEW_BORDER / view.pixel), 1)
    if settings.size_known and (failure := intrusion(segmentation, view, margin)) is not None:
        return failure
    if segmentation.others_share > (LITTER_SHARE if settings.size_known else RIVAL_SHARE):
        return Failure(
            FailureKind.UNKNOWN_GARMENT,
            "more than one thing lies on the table",
            "leave a single garment on the table",
            {"other_area_share": segmentation.others_share},
        )
    if segmentation.confidence < MIN_SEGMENTATION:
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"only {segmentation.confidence:.0%} of the garment's boundary is clearly visible",
            "the fabric has the table's colour, or the light changed: take a new picture of the empty table"
            if referenced
            else "use a table of another colour, or more even light",
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


def adjoined(segmentation: Segmentation, seen: RectifiedView, view: TableView) -> Failure | None:
    """Return UNKNOWN_GARMENT if something else than the ground lies beside a stretch of a region's outline, else
    None: the region is a part of a garment, such as a print."""
    share, (column, row) = foreign_stretch(seen.rgb, seen.valid, segmentation)
    if share <= MOST_FOREIGN:
        return None
    middle = segmentation.contour.mean(axis=0)
    away = {
        "right": column - middle[0],
        "left": middle[0] - column,
        "lower": row - middle[1],
        "upper": middle[1] - row,
    }
    side = max(away, key=lambda name: away[name])
    return Failure(
        FailureKind.UNKNOWN_GARMENT,
        f"something else than the ground lies beside {share:.0%} of the outline, on its {side} side: it may be a "
        "print or a part of the garment",
        "lay the garment on a ground of another colour, with nothing beside it",
        {"foreign_share": share},
    )


def intrusion(segmentation: Segmentation, view: TableView, margin: int) -> Failure | None:
    """Return VIEW_OBSTRUCTED if something flat beside the garment reaches into the picture, to within `margin`
    pixels of the border, else None."""
    share = segmentation.others_share
    if share <= INTRUDER_SHARE or not touches_border(segmentation.others, view.valid, margin):
        return None
    return obstruction_failure(view, segmentation.others, "something flat", {"other_area_share": share})


def touches_border(mask: NDArray[np.bool_], valid: NDArray[np.bool_], margin: int) -> bool:
    """Whether a region comes within `margin` pixels of the border of the valid view."""
    size = 2 * margin + 1
    inner = cv2.erode(valid.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0
    return bool((mask & ~inner).any())
