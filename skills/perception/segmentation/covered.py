"""Detection, by height, of an object that covers much of the table, whose colour can be the most frequent one."""

from __future__ import annotations

import cv2
import numpy as np

from skills.perception.segmentation.mask import Field, Mask, eroded

__all__ = ["covered", "mean_height"]

_MIN_HEIGHT = 0.0012
"""Mean height over a square of `_WINDOW` pixels from which something lies there [m]: four times its noise."""
_WINDOW = 5
_MIN_SHARE = 0.4
"""Share of the view above which covered pixels are reported. Fewer are outliers among the table's pixels."""
_RIM = 2
_MAX_RIM_SHARE = 0.25
"""Share of the view's rim, `_RIM` pixels wide, above which the height is not trusted if the rim is high too."""


def covered(height: Field, valid: Mask) -> Mask:
    """Mask (h, w) of something large above the table; empty unless it covers much of the view.

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
    """Mean height (h, w) over the known part of a square of `size` pixels [m], and where enough of it is known."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.asarray(total / np.maximum(share, 1e-3), dtype=np.float32), share > 0.3
