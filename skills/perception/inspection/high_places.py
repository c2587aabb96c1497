"""How far folded cloth stands above its layers lying flat: what hands could press down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.inspection.predicted_view import draw_shape
from skills.perception.perceive import smooth_height
from skills.perception.rectification.table_view import TableView
from skills.vocabulary import PredictedShape

__all__ = ["Standing", "standing"]

RIM = 9
"""Pixels: cloth is looked at half as far inside its silhouette, where depth mixes with the table's."""
EDGE = 0.030
"""Clear of an edge is what is so far inside it [m]: fingers leave alone the bulge of a crease that is there.
Chosen by few trials: with 35 mm large towels are pressed in too few places, with 25 mm shorts are shoved."""
LIKE = 5
"""Pixels over which a place is as high as its mean."""
LACKING = 0.0035
"""Where the stack is lower than its layers by so much, the upper ones are not there [m]."""

LOOKS = 3
"""How often a place is looked up, each time where it appears at the height seen before."""


@dataclass(frozen=True, eq=False)
class Standing:
    """Where a garment stands above the flat stack.

    places: (k, 2) [m] that do, by above (k,) [m]. inside: whether a place (2,) [m] lies clear of every edge of the
    stack, those of its upper layers among them: a finger at an edge turns it up or pushes it back.
    """

    places: Array
    above: Array
    inside: Callable[[Array], bool]


def standing(
    height: NDArray[np.float32],
    mask: NDArray[np.bool_],
    view: TableView,
    flat: PredictedShape,
    thickness: float,
    least: float,
) -> Standing:
    """What stands above the flat stack by `least` [m] and more.

    height (H, W) above the table [m], NaN where nothing was seen, and mask (H, W) of the garment in `view`. flat:
    the fold as it would be if creases had no height, vertices in the middle of layers `thickness` [m] thick.
    """
    inner = cv2.erode(mask.astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0
    smooth = smooth_height(height, LIKE)
    above = smooth - draw_shape(view, flat) - np.float32(0.5 * thickness)
    rows, columns = np.nonzero(inner & np.isfinite(height) & (np.nan_to_num(above, nan=-1.0) >= least))
    places = view.to_table(np.stack([columns, rows], axis=1), smooth[rows, columns].astype(float))
    whole = mask & (np.nan_to_num(above, nan=0.0) > -LACKING)
    return Standing(places, above[rows, columns].astype(float), _clear_of_edges(whole, smooth, view))


def _clear_of_edges(
    whole: NDArray[np.bool_], smooth: NDArray[np.float32], view: TableView
) -> Callable[[Array], bool]:
    """whole: (H, W) where all layers of the stack are seen; smooth: (H, W) how high [m]."""
    closed = cv2.morphologyEx(whole.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    depth = cv2.distanceTransform(closed, cv2.DIST_L2, 5) * view.pixel
    heights = smooth[whole & np.isfinite(smooth)]
    usual = float(np.median(heights)) if len(heights) else 0.0

    def inside(place: Array) -> bool:
        """Looked up where cloth at this place appears: if it is as high as usual, and as high as is seen there."""
        up = usual
        for _ in range(LOOKS):
            column, row = np.round(view.to_pixel(view.shadow_on_table(np.array([*place, up])))).astype(int)
            if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
                return False
            if not depth[row, column] * (1.0 - up / view.camera_position[2]) > EDGE:
                return False
            up = float(smooth[row, column]) if np.isfinite(smooth[row, column]) else usual
        return True

    return inside
