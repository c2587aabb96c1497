"""Detects, by height, an object that covers much of the table. Its colour can be the most frequent one, so it
could be mistaken for the table."""

from __future__ import annotations

import cv2
import numpy as np

from skills.perception.segmentation.mask import Field, Mask, eroded

__all__ = ["covered", "mean_height"]

_MIN_HEIGHT = 0.0012
"""A place is covered if the mean height over a square of `_WINDOW` pixels is above this [m]: four times the noise
of this mean."""
_WINDOW = 5
_MIN_SHARE = 0.4
"""Covered pixels are reported only if their share of the view is larger than this. If it is smaller, the table's
colour is the most frequent one, so the object cannot be mistaken for the table."""
_RIM = 2
_MAX_RIM_SHARE = 0.25
"""If more than this share of the view's rim, which is `_RIM` pixels wide, is also above `_MIN_HEIGHT`, the height
is not trusted and no covered pixels are reported."""


def covered(height: Field, valid: Mask) -> Mask:
    """Return the mask (h, w) of a large object on the table; the mask is empty unless the object covers much of
    the view.

    height: (h, w) above the table [m], NaN where unknown. valid: (h, w), where the camera sees the table.
    """
    mean, known = mean_height(height, _WINDOW)
    high = known & (mean > _MIN_HEIGHT) & valid
    rim = valid & ~eroded(valid, _RIM)
    large = np.count_nonzero(high) > _MIN_SHARE * np.count_nonzero(valid)
    if not large or np.count_nonzero(high & rim) > _MAX_RIM_SHARE * np.count_nonzero(rim):
        return np.zeros(valid.shape, bool)
    return high


def mean_height(height: Field, size: int) -> tuple[Field, Mask]:
    """Average the height over the known part of a square of `size` pixels around each pixel. Return the mean
    (h, w) [m], and the mask (h, w) of pixels at which enough of the square is known."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.asarray(total / np.maximum(share, 1e-3), dtype=np.float32), share > 0.3
