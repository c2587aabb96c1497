"""Heights above the table in a rectified picture, and those of a garment in it.

The true height of the empty table is 0 everywhere, so its measured height shows the error of the calibration at
each place.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.rectification.table_view import RectifiedView

LOFTY = 1.4
"""Largest ratio of the height of cloth to the height that follows from its stated thickness. The two differ,
because fabrics differ and loose layers do not lie flat."""
_FEWEST = 100
"""A percentile is computed only if there are more pixels than this."""
_REDUCTION = 4
"""Edge length of a coarse pixel, in view pixels. The height is smoothed on coarse pixels."""
_SIGMA = 1.0
"""Standard deviation of the smoothing, in coarse pixels."""
_MIN_KNOWN_SHARE = 0.25
"""If a smaller share than this of a place's surroundings is known, the value of the nearest place with a larger
share is used."""


def height_above(seen: RectifiedView, empty: RectifiedView | None) -> NDArray[np.float32]:
    """Compute the height (H, W) above the measured empty table [m], which cancels the calibration's error."""
    if empty is None:
        return seen.height
    return np.asarray(seen.height - table_height(empty.height), dtype=np.float32)


def upper(heights: NDArray[np.floating]) -> float:
    """Return the 95th percentile of heights (n,) [m]; NaN for `_FEWEST` or fewer."""
    return float(np.quantile(heights, 0.95)) if len(heights) > _FEWEST else float("nan")


def garment_height(mask: NDArray[np.bool_], height: NDArray[np.float32]) -> float:
    """Mean height of a garment above the table, limited to 0..0.02 [m]; 0 without depth. Its outline is assumed to
    lie at this height."""
    samples = height[mask & np.isfinite(height)]
    return float(np.clip(samples.mean(dtype=float), 0.0, 0.02)) if len(samples) > 1000 else 0.0


def smooth_height(height: NDArray[np.float32], size: int = 9, least_known: float = 0.25) -> NDArray[np.float32]:
    """Average the height (H, W) [m] over the known part of a square of `size` pixels around each pixel. The result
    (H, W) [m] is NaN where no more than the share `least_known` of the square is known."""
    known = np.isfinite(height)
    total = cv2.boxFilter(np.where(known, height, np.float32(0.0)), -1, (size, size))
    share = cv2.boxFilter(known.astype(np.float32), -1, (size, size))
    return np.where(share > least_known, total / np.maximum(share, 1e-6), np.float32(np.nan)).astype(np.float32)


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
