"""The empty table's height as it was measured: what the calibration is wrong by, place by place."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["table_height"]

_FINER = 4
"""View pixels across a coarse one, on which the table is smoothed."""
_SIGMA = 1.0
"""Of the smoothing, in coarse pixels."""
_ENOUGH = 0.25
"""Where less of the surroundings is known, the nearest place counts where that much is."""


def table_height(measured: NDArray[np.float32]) -> NDArray[np.float32]:
    """Smooth height (H, W) [m] of the empty table as measured (H, W) [m], NaN where nothing was.

    Only what is known counts: a hole takes the height of what surrounds it. 0 where nothing is known at all.
    """
    known = np.isfinite(measured)
    if not known.any():
        return np.zeros(measured.shape, np.float32)
    coarse = _blurred(np.where(known, measured, np.float32(0.0)))
    if not known.all():
        share = _blurred(known.astype(np.float32))
        enough = share >= min(_ENOUGH, float(share.max()))
        mean = np.asarray(coarse / np.maximum(share, np.float32(1e-6)), dtype=np.float32)
        coarse = _from_nearest(mean, enough)
    rows, columns = measured.shape
    return np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _blurred(image: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, columns = image.shape
    size = (max(columns // _FINER, 1), max(rows // _FINER, 1))
    coarse = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(coarse, (0, 0), _SIGMA), dtype=np.float32)


def _from_nearest(values: NDArray[np.float32], good: NDArray[np.bool_]) -> NDArray[np.float32]:
    """values (h, w) where they are good, elsewhere that of the nearest place where they are."""
    if good.all():
        return values
    _, label = cv2.distanceTransformWithLabels(
        (~good).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(label.max()) + 1, np.float32)
    of_label[label[good]] = values[good]
    return np.asarray(of_label[label], dtype=np.float32)
