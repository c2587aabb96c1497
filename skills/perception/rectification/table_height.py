"""Smoothed height of the empty table as measured, which is the local error of the calibration."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["table_height"]

_REDUCTION = 4
"""Number of view pixels along the edge of a coarse pixel, on which the table is smoothed."""
_SIGMA = 1.0
"""Standard deviation of the smoothing, in coarse pixels."""
_MIN_KNOWN_SHARE = 0.25
"""Minimum known share of the surroundings; below it the nearest place with this share is used."""


def table_height(measured: NDArray[np.float32]) -> NDArray[np.float32]:
    """Smoothed height (H, W) of the empty table from the measured one (H, W), NaN where unknown, both [m].

    Only known pixels count: a hole takes the height of its surroundings. All 0 when nothing is known.
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
    """values (h, w) where they are valid, elsewhere the value at the nearest valid place."""
    if valid.all():
        return values
    _, label = cv2.distanceTransformWithLabels(
        (~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label_value = np.zeros(int(label.max()) + 1, np.float32)
    label_value[label[valid]] = values[valid]
    return np.asarray(label_value[label], dtype=np.float32)
