"""Finds places where folded cloth stands higher than its flat layers, so that the hands can press them down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.inspection.predicted_view import draw_shape
from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import PredictedShape

EROSION = 9
"""Side of the square by which the silhouette is eroded [px]. At its rim, depths of cloth and table are mixed."""
EDGE = 0.030
"""Minimum distance of a pressing finger from an edge of the cloth [m]. It was chosen by a few trials: 35 mm leaves
too few places on large towels; with 25 mm, fingers push shorts away."""
WINDOW = 5
"""Side of the square over which the height is averaged [px]."""
MISSING_DEPTH = 0.0035
"""Where the cloth is lower than the flat stack by more than this, upper layers are missing [m]."""

LOOKUPS = 3
"""Number of iterations that find the pixel of a place. The pixel depends on the height of the cloth, so each
iteration uses the height found by the one before."""


@dataclass(frozen=True, eq=False)
class HighPlaces:
    """Places where a garment is higher than the flat stack.

    places: (k, 2) [m]. above: (k,) height above the flat stack [m]. inside: function that returns whether a place
    (2,) [m] is at least EDGE away from every edge of the stack and of its upper layers. Nearer to an edge, a
    finger would turn it up or push it back.
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
    the ideal fold, whose creases are as flat as its layers. Its vertices lie in the middle of layers that are
    `thickness` [m] thick.
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
    """Create the function `HighPlaces.inside`. whole: (H, W) whether all layers are present. smooth: (H, W)
    averaged height [m]."""
    closed = cv2.morphologyEx(whole.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    edge_distance = cv2.distanceTransform(closed, cv2.DIST_L2, 5) * view.pixel
    heights = smooth[whole & np.isfinite(smooth)]
    median_height = float(np.median(heights)) if len(heights) else 0.0

    def inside(place: Array) -> bool:
        """Whether the place is far enough from all edges. The pixel at which its cloth appears is computed first
        with the median height, then with the measured height."""
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
