"""Averages the heights of two looks at a garment that lies still, so that a second opinion is better founded than
the first, and not only another draw of the same noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skills.perception.inspection.result import Inspection
from skills.perception.rectification.heights import smooth_height

__all__ = ["averaged_height"]

STILL_IOU = 0.97
"""Least overlap of the silhouettes of a garment that lies still."""
STILL_M, NEARLY_ALL = 0.002, 0.99
"""Largest difference between its smoothed heights [m], on nearly all of its inner part. In pictures of a garment
at rest it was 0.7 to 0.8 mm, after it had been pressed 6.6 mm."""
RIM = 5
"""Width of the outer part, where the smoothed heights of cloth and table mix [pixels]."""


def averaged_height(
    height: NDArray[np.float32], mask: NDArray[np.bool_], earlier: Inspection
) -> NDArray[np.float32]:
    """Return the mean of the height (H, W) and that of an earlier look [m], where both are known; the height
    itself if the garment (mask, (H, W)) lies elsewhere or differently now."""
    if earlier.mask.shape != mask.shape:
        return height
    if np.count_nonzero(mask & earlier.mask) < STILL_IOU * np.count_nonzero(mask | earlier.mask):
        return height
    inner = cv2.erode((mask & earlier.mask).astype(np.uint8), np.ones((2 * RIM + 1,) * 2)) > 0
    difference = np.abs(smooth_height(height) - smooth_height(earlier.height))[inner]
    difference = difference[np.isfinite(difference)]
    if not len(difference) or np.quantile(difference, NEARLY_ALL) > STILL_M:
        return height
    both = np.isfinite(height) & np.isfinite(earlier.height)
    return np.where(both, 0.5 * (height + earlier.height), height).astype(np.float32)
