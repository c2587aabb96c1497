"""Smooths the measured height of the empty table.

The true height is 0 everywhere, so the measured height shows the error of the calibration at each place.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["table_height"]

_REDUCTION = 4
"""Edge length of a coarse pixel, in view pixels. The height is smoothed on coarse pixels."""
_SIGMA = 1.0
"""Standard deviation of the smoothing, in coarse pixels."""
_MIN_KNOWN_SHARE = 0.25
"""If a smaller share than this of a place's surroundings is known, the value of the nearest place with a larger
share is used."""


def table_height(measured: NDArray[np.float32]) -> NDArray[np.float32]:
    """Smooth the measured height (H, W) of the empty table [m], NaN where unknown; the result is (H, W) [m].

    Only known pixels count: a hole takes the height of its surroundings. If nothing is known, the result is 0.
    """
    known = np.isfinite(measured)
    if not known.any():
        return np.zeros(measured.shape, np.float32)
    coarse = _blurred(np.where(known, measured, np.float32(0.0)))
    if not known.all():
        share = _blurred(known.astype(np.float32))
        enough = share >= min(_MIN_KNOWN_SHARE, float(share.max()))
        mean = np.asarray(coarse / np.maximum(share, np.float32(1e-6)), dtype=np.float32)
        coarse = _from_nearest(mean, enough)
    rows, columns = measured.shape
    return np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _blurred(image: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, columns = image.shape
    size = (max(columns // _REDUCTION, 1), max(rows // _REDUCTION, 1))
    coarse = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(coarse, (0, 0), _SIGMA), dtype=np.float32)


def _from_nearest(values: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return values (h, w) in which each invalid value is replaced by the nearest valid one."""
    if valid.all():
        return values
    _, label = cv2.distanceTransformWithLabels(
        (~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label_value = np.zeros(int(label.max()) + 1, np.float32)
    label_value[label[valid]] = values[valid]
    return np.asarray(label_value[label], dtype=np.float32)
