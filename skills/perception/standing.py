"""How far folded cloth stands above its layers lying flat: what hands could press down."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.predicted_view import draw_shape
from skills.perception.view import TableView
from skills.vocabulary import PredictedShape

__all__ = ["standing_places"]

RIM = 9
"""Pixels: cloth is looked at half as far inside its silhouette, where depth mixes with the table's."""
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
