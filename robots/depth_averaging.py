"""A still picture's depth out of several exposures: one exposure's noise is larger than a layer of cloth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robots.ports import frozen

__all__ = ["EVERY_S", "EXPOSURES", "mean_depth"]

EXPOSURES = 8
"""Of a still picture."""
EVERY_S = 1.0 / 30.0
"""From one to the next, of an RGB-D camera [s]."""
APART = 0.030
"""Exposures that differ by more [m] saw different surfaces beside an edge: a median that one of them saw counts,
not their mean, which is on neither."""


def mean_depth(exposures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """(H, W) mean of depths [m] of one size; NaN where fewer than half of them saw anything."""
    if len(exposures) == 1:
        return exposures[0]
    depth = np.stack(exposures)
    seen = np.isfinite(depth)
    count = seen.sum(axis=0)
    known = 2 * count >= len(depth)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(seen, depth, 0.0).sum(axis=0, dtype=np.float64) / count
        apart = known & (np.fmax.reduce(depth) - np.fmin.reduce(depth) > APART)
    middle = (count[apart] - 1) // 2  # sorted, what was not seen comes last
    mean[apart] = np.take_along_axis(np.sort(depth[:, apart], axis=0), middle[None], axis=0)[0]
    mean[~known] = np.nan
    return frozen(mean.astype(np.float32))
