"""Finds a hand, an arm or a tool that reaches into the picture from its border, by its height.

A garment lies low, and it lies inside the view. Something that stands high at the border of the view is neither
the table nor the garment, whatever its colour, also if it hides a part of the garment.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.rectification.table_view import BELOW, RectifiedView, TableView
from foldcell.skills.perception.segmentation.mask import Field, Mask, eroded
from foldcell.skills.perception.segmentation.table_model import KNOWN_SHARE
from foldcell.skills.vocabulary import Failure, FailureKind

MIN_HEIGHT = 0.035
"""An obstruction is higher than this at the border [m]. A wrist is 40 to 60 mm thick. A garment that may be folded
is at most `PerceptionSettings.flat_height` high, and a folded stack does not reach the border."""
MIN_AREA = 0.004
"""Smallest area of an obstruction [m2]: half a hand. The elbows of parked arms show at most 0.0016."""
SPREAD = 0.03
"""Parts of the robot in the picture of the empty table are widened by this length [m], because the arms do not
park at exactly the same place again."""
_WINDOW = 9
"""Side of the square over which the height is averaged [px]."""
_BORDER = 5
"""Width of the border of the view [px]."""


def obstructed(
    view: TableView, seen: RectifiedView, empty: RectifiedView | None, name: str = "something"
) -> Failure | None:
    """Return VIEW_OBSTRUCTED if something high reaches into the picture, else None. empty: the picture of the
    empty table, or None. name: what it is, for the message."""
    known = standing_parts(empty, view.pixel) if empty is not None else None
    found = find_obstruction(seen, known, view.pixel)
    if not found.any():
        return None
    top = float(np.nanquantile(_levelled(seen)[found], 0.9))
    return obstruction_failure(view, found, f"{name} {top * 1e3:.0f} mm high", {"height_m": top})


def obstruction_failure(view: TableView, found: Mask, name: str, values: Mapping[str, float]) -> Failure:
    """Return VIEW_OBSTRUCTED for an object, with the edge of the picture from which it reaches in. found: (H, W)
    the object; name: what it is, for the message."""
    rows, columns = np.nonzero(found & _border(view.valid))
    sides = {
        "far": rows / view.shape[0], "near": 1.0 - rows / view.shape[0],
        "left": columns / view.shape[1], "right": 1.0 - columns / view.shape[1],
    }  # fmt: skip
    side = min(sides, key=lambda name: float(np.mean(sides[name]))) if len(rows) else "outer"
    area = float(np.count_nonzero(found)) * view.pixel**2
    return Failure(
        FailureKind.VIEW_OBSTRUCTED,
        f"{name} reaches into the picture from its {side} edge ({area * 1e4:.0f} cm2)",
        "take hands, arms and tools out of the camera's view; the cell goes on when they are gone",
        {"area_m2": area, **values},
    )


def find_obstruction(seen: RectifiedView, known: Mask | None, pixel: float) -> Mask:
    """Return the mask (H, W) of everything high that reaches into the view from its border.

    known: (H, W), what stood high in the picture of the empty table (`standing_parts`), for example the robot's
    parked elbows; None without such a picture. pixel: edge of a pixel [m].
    """
    high = _levelled(seen) > MIN_HEIGHT
    if known is not None:
        high &= ~known
    found = np.zeros(high.shape, bool)
    if not high.any():
        return found
    border = _border(seen.valid)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(high.astype(np.uint8))
    for i in range(1, count):
        if stats[i, cv2.CC_STAT_AREA] * pixel**2 >= MIN_AREA and (border & (labels == i)).any():
            found |= labels == i
    return found


def standing_parts(empty: RectifiedView, pixel: float) -> Mask:
    """Return the mask (H, W) of what stands high in the picture of the empty table, widened by `SPREAD`."""
    high = (_levelled(empty) > 0.5 * MIN_HEIGHT).astype(np.uint8)
    size = 2 * round(SPREAD / pixel) + 1
    return cv2.dilate(high, np.ones((size, size), np.uint8)) > 0


def _levelled(seen: RectifiedView) -> Field:
    """Return the height (H, W) above the table [m], averaged over `_WINDOW`; NaN where it is not known. The median
    of the view, at most `BELOW`, is subtracted, because the calibration may be a few centimetres off, and most of
    the view shows the table or a flat garment, unless something hides most of it."""
    mean = np.where(seen.valid, smooth_height(seen.height, _WINDOW, KNOWN_SHARE), np.float32(np.nan))
    measured = mean[np.isfinite(mean)]
    return mean - (float(np.clip(np.median(measured), -BELOW, BELOW)) if len(measured) else 0.0)


def _border(valid: Mask) -> Mask:
    return valid & ~eroded(valid, _BORDER)
