"""Where much of the table is covered, by height: the commonest colour may be the garment's there."""

from __future__ import annotations

import cv2
import numpy as np

from skills.perception.segmentation.mask import Field, Mask, eroded

__all__ = ["covered", "mean_height"]

_STANDS = 0.0012
"""From this mean height over a square of `_WIDE` pixels on, something lies there: four times its noise [m]."""
_WIDE = 5
_MUCH = 0.4
"""Share of the view from which what stands there is told. Less is an outlier among the table's pixels anyhow."""
_RIM = 2
_AT_RIM = 0.25
"""Where so much of the view's rim, `_RIM` pixels wide, stands up too, height is not to be trusted."""


def covered(height: Field, valid: Mask) -> Mask:
    """Where (h, w) something large stands above the table: nowhere, unless it covers much of the view.

    height: (h, w) [m] above the table, NaN where unknown; valid: (h, w), where the camera sees the table.
    """
    mean, known = mean_height(height, _WIDE)
    stands = known & (mean > _STANDS) & valid
    rim = valid & ~eroded(valid, _RIM)
    much = np.count_nonzero(stands) > _MUCH * np.count_nonzero(valid)
    if not much or np.count_nonzero(stands & rim) > _AT_RIM * np.count_nonzero(rim):
        return np.zeros(valid.shape, bool)
    return stands


def mean_height(height: Field, size: int) -> tuple[Field, Mask]:
    """Mean (h, w) over a square of `size` pixels of what depth knows, and where it knows enough."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.asarray(total / np.maximum(share, 1e-3), dtype=np.float32), share > 0.3
