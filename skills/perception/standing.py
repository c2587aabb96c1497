"""How far folded cloth stands above its layers lying flat: what hands could press down."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.predicted_view import draw_shape
from skills.perception.view import TableView
from skills.vocabulary import PredictedShape

__all__ = ["standing_places", "well_inside"]

RIM = 9
"""Pixels: cloth is looked at half as far inside its silhouette, where depth mixes with the table's."""
EDGE = 0.016
"""Clear of the silhouette is what is so far inside it [m]: a finger's width."""
LIKE = 5
"""Pixels over which a place is as high as its mean."""


def standing_places(
    height: NDArray[np.float32],
    mask: NDArray[np.bool_],
    view: TableView,
    flat: PredictedShape,
    thickness: float,
    least: float,
) -> tuple[Array, Array]:
    """Places (k, 2) [m] that stand above the flat stack by `least` [m] and more, and by how much (k,) [m].

    height (H, W) above the table [m], NaN where nothing was seen, and mask (H, W) of the garment in `view`. flat:
    the fold as it would be if creases had no height, vertices in the middle of layers `thickness` [m] thick.
    """
    inner = cv2.erode(mask.astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0
    known = np.isfinite(height)
    mean = cv2.blur(np.where(known, height, np.float32(0.0)), (LIKE, LIKE))
    above = mean - draw_shape(view, flat) - np.float32(0.5 * thickness)
    rows, columns = np.nonzero(inner & known & (np.nan_to_num(above, nan=-1.0) >= least))
    c = view.camera_position
    # seen along a slanted line: what is high stands nearer to the camera than it appears on the table
    on_table = view.to_table(np.stack([columns, rows], axis=1)) - c[:2]
    places = c[:2] + on_table * (1.0 - mean[rows, columns][:, None] / c[2])
    return places, above[rows, columns].astype(float)


def well_inside(mask: NDArray[np.bool_], view: TableView) -> Callable[[Array], bool]:
    """Whether a place (2,) [m] is on the garment, whose mask (H, W) is seen in `view`, and clear of its edges."""
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) * view.pixel

    def inside(place: Array) -> bool:
        column, row = np.round(view.to_pixel(place)).astype(int)
        return bool(0 <= row < depth.shape[0] and 0 <= column < depth.shape[1] and depth[row, column] > EDGE)

    return inside
