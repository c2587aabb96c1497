"""Renders a predicted mesh as the camera sees it, and moves view images rigidly."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.boundary import longest_contour
from foldcell.skills.vocabulary import PredictedShape


def draw_shape(view: TableView, shape: PredictedShape) -> NDArray[np.float32]:
    """Render the height (H, W) of a predicted mesh as the camera sees it [m], NaN outside the mesh.

    Each triangle is drawn where it appears in the view, with parallax. Low triangles are drawn first, so higher
    ones cover them.
    """
    place = np.round(view.to_pixel(view.shadow_on_table(shape.vertices)) * 16).astype(np.int32)
    z = shape.vertices[shape.triangles, 2].mean(axis=1)
    image = np.full(view.shape, np.nan, np.float32)
    for i in np.argsort(z, kind="stable"):
        cv2.fillConvexPoly(image, place[shape.triangles[i]], float(z[i]), cv2.LINE_8, 4)
    return image


def outline_of(view: TableView, mask: NDArray[np.bool_]) -> Array:
    """Return the longest boundary (n, 2) of a region [m]. Raises ValueError when the region is empty."""
    if not mask.any():
        raise ValueError("the predicted shape lies outside of the view")
    return view.to_table(longest_contour(mask))


def mask_iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Compute the intersection over union of two masks (H, W); 0 if both are empty."""
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0


def move_view(view: TableView, image: NDArray[np.float32], R: Array, t: Array) -> NDArray[np.float32]:
    """Move a view image by the motion p -> R p + t [m] on the table; NaN where no source pixel exists."""
    corners = np.array([[0.0, 0.0], [view.shape[1], 0.0], [0.0, view.shape[0]]])
    to = view.to_pixel(view.to_table(corners) @ R.T + t)
    M = cv2.getAffineTransform(corners.astype(np.float32), to.astype(np.float32))
    size = (view.shape[1], view.shape[0])
    moved = cv2.warpAffine(
        image, M, size, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
    )
    return moved.astype(np.float32, copy=False)
