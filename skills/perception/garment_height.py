"""Heights above the table in a rectified picture, and those of a garment in it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from skills.perception.rectification.table_height import table_height
from skills.perception.rectification.table_view import RectifiedView

__all__ = ["LOFTY", "garment_height", "height_above", "smooth_height", "upper_height"]

LOFTY = 1.4
"""Largest ratio between the height of cloth and the one that its stated thickness gives: fabrics differ, and loose
layers do not lie flat."""


def height_above(seen: RectifiedView, empty: RectifiedView | None) -> NDArray[np.float32]:
    """Compute the height (H, W) above the measured empty table [m], which cancels the calibration's error."""
    if empty is None:
        return seen.height
    return np.asarray(seen.height - table_height(empty.height), dtype=np.float32)


def upper_height(mask: NDArray[np.bool_], height: NDArray[np.float32]) -> float:
    """95th percentile of the smoothed height within a mask [m]; 0 without depth."""
    smooth = smooth_height(height)
    samples = smooth[mask & np.isfinite(smooth)]
    return float(np.quantile(samples, 0.95)) if len(samples) > 100 else 0.0


def garment_height(mask: NDArray[np.bool_], height: NDArray[np.float32]) -> float:
    """Mean height of a garment above the table, limited to 0..0.02 [m]; 0 without depth. Its outline is assumed to
    lie at this height."""
    samples = height[mask & np.isfinite(height)]
    return float(np.clip(samples.mean(dtype=float), 0.0, 0.02)) if len(samples) > 1000 else 0.0


def smooth_height(height: NDArray[np.float32], size: int = 9) -> NDArray[np.float32]:
    """Average the height over the known part of a square of `size` pixels around each pixel [m]; NaN where too
    little is known."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.where(share > 0.25, total / np.maximum(share, 1e-6), np.float32(np.nan)).astype(np.float32)
