"""Segments a garment by watershed, as in the paper (Vincent and Soille 1991)."""

from __future__ import annotations

import cv2
import numpy as np

from foldcell.skills.perception.segmentation.mask import Image, Mask, Segmentation, outlined


def segment_watershed(rgb: Image, valid: Mask) -> Segmentation:
    """Segment rgb (H, W, 3) where valid (H, W). The four corners are assumed to be background, the centre
    garment."""
    rows, columns = np.nonzero(valid)
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    radius = max(min(bottom - top, right - left) // 20, 2)
    markers = np.zeros(valid.shape, np.int32)
    for row in (top + radius, bottom - radius):
        inside = np.flatnonzero(valid[row])
        for column in (inside[0] + radius, inside[-1] - radius):
            cv2.circle(markers, (int(column), int(row)), int(radius), 1, -1)
    cv2.circle(markers, (int(left + right) // 2, int(top + bottom) // 2), int(radius), 2, -1)
    markers[~valid] = 1
    labels = cv2.watershed(np.ascontiguousarray(cv2.medianBlur(rgb, 5)), markers)
    return outlined(labels == 2, rgb, valid)
