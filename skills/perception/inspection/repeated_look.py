"""Averages the heights of two looks at a garment that lies still, so that a second opinion is better founded than
the first, and not only another draw of the same noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skills.perception.inspection.result import Inspection

__all__ = ["averaged_height"]

STILL_IOU = 0.97
"""Least overlap of the silhouettes of a garment that lies still."""


def averaged_height(
    height: NDArray[np.float32], mask: NDArray[np.bool_], earlier: Inspection
) -> NDArray[np.float32]:
    """Return the mean of the height (H, W) and that of an earlier look [m], where both are known; the height
    itself if the garment (mask, (H, W)) lies elsewhere now."""
    if earlier.mask.shape != mask.shape:
        return height
    if np.count_nonzero(mask & earlier.mask) < STILL_IOU * np.count_nonzero(mask | earlier.mask):
        return height
    both = np.isfinite(height) & np.isfinite(earlier.height)
    return np.where(both, 0.5 * (height + earlier.height), height).astype(np.float32)
