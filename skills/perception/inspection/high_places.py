"""Places where folded cloth is higher than its flat layers, which the hands can press down."""

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

__all__ = ["HighPlaces", "find_high_places"]

EROSION = 9
"""Size of the erosion of the silhouette [px]. At its rim, depths of cloth and table are mixed."""
EDGE = 0.030
"""Minimum distance of the fingers from an edge [m], outside the bulge of a crease.
Chosen by a few trials: 35 mm leaves too few places on large towels; with 25 mm, shorts are pushed away."""
WINDOW = 5
"""Window of the mean height [px]."""
MISSING_DEPTH = 0.0035
"""Height below the flat stack from which upper layers are missing [m]."""

LOOKUPS = 3
"""Number of iterations of a look-up, each at the height found by the one before."""


@dataclass(frozen=True, eq=False)
class HighPlaces:
    """Places where a garment is higher than the flat stack.

    places: (k, 2) [m]. above: (k,) height above the flat stack [m]. inside: whether a place (2,) [m] is at least
    EDGE away from every edge of the stack and of its upper layers, which a finger would turn up or push back.
    """

    places: Array
    above: Array
    inside: Callable[[Array], bool]


def find_high_places(
    height: NDArray[np.float32],
    mask: NDArray[np.bool_],
    view: TableView,
    flat: PredictedShape,
    thickness: float,
    min_height: float,
) -> HighPlaces:
    """Find the places that are at least `min_height` [m] higher than the flat stack.

    height: (H, W) above the table [m], NaN where unknown, and mask: (H, W) of the garment, both in `view`. flat:
    the fold without the height of its creases, with vertices in the middle of layers `thickness` [m] thick.
    """
    inner = cv2.erode(mask.astype(np.uint8), np.ones((EROSION, EROSION), np.uint8)) > 0
    smooth = smooth_height(height, WINDOW)
    above = smooth - draw_shape(view, flat) - np.float32(0.5 * thickness)
    rows, columns = np.nonzero(inner & np.isfinite(height) & (np.nan_to_num(above, nan=-1.0) >= min_height))
    places = view.to_table(np.stack([columns, rows], axis=1), smooth[rows, columns].astype(float))
    whole = mask & (np.nan_to_num(above, nan=0.0) > -MISSING_DEPTH)
    return HighPlaces(places, above[rows, columns].astype(float), _clear_of_edges(whole, smooth, view))


def _clear_of_edges(
    whole: NDArray[np.bool_], smooth: NDArray[np.float32], view: TableView
) -> Callable[[Array], bool]:
    """The function `HighPlaces.inside`. whole: (H, W), where all layers are present; smooth: (H, W) height [m]."""
    closed = cv2.morphologyEx(whole.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    edge_distance = cv2.distanceTransform(closed, cv2.DIST_L2, 5) * view.pixel
    heights = smooth[whole & np.isfinite(smooth)]
    median_height = float(np.median(heights)) if len(heights) else 0.0

    def inside(place: Array) -> bool:
        """Looks up where the cloth at this place appears in the view: first with the median height, then with the
        measured one."""
        cloth_height = median_height
        for _ in range(LOOKUPS):
            column, row = np.round(view.to_pixel(view.shadow_on_table(np.array([*place, cloth_height])))).astype(
                int
            )
            if not (0 <= row < edge_distance.shape[0] and 0 <= column < edge_distance.shape[1]):
                return False
            if not edge_distance[row, column] * (1.0 - cloth_height / view.camera_position[2]) > EDGE:
                return False
            cloth_height = float(smooth[row, column]) if np.isfinite(smooth[row, column]) else median_height
        return True

    return inside
