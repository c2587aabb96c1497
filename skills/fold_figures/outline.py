"""The outline of a garment's mesh as seen from above."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array

__all__ = ["outline"]

OUTLINE_PIXEL = 0.001
"""Outlines are traced in pixels of this size on the table [m]."""


def outline(vertices: Array, triangles: NDArray[np.integer]) -> list[Array]:
    """Return the silhouette from above: outer contours [(k, 2), ...] in the table frame [m], the largest first."""
    low = vertices[:, :2].min(axis=0) - 5 * OUTLINE_PIXEL
    size = np.ceil((vertices[:, :2].max(axis=0) - low) / OUTLINE_PIXEL).astype(int) + 6
    mask = np.zeros((int(size[1]), int(size[0])), dtype=np.uint8)
    pixels = np.round((vertices[:, :2] - low) / OUTLINE_PIXEL).astype(np.int32)
    for triangle in pixels[triangles]:  # one fillPoly call for all would leave overlaps unfilled
        cv2.fillConvexPoly(mask, triangle, 255)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    smooth = [cv2.approxPolyDP(c, 1.0, True)[:, 0, :] for c in sorted(contours, key=cv2.contourArea, reverse=True)]
    return [c * OUTLINE_PIXEL + low for c in smooth if len(c) >= 3]
