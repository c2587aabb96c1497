"""Depth of a still picture as the mean of several exposures. The noise of a single exposure is larger than the
thickness of a layer of cloth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import frozen

EXPOSURES = 8
"""Number of exposures of a still picture."""
EVERY_S = 1.0 / 30.0
"""Period of the exposures of an RGB-D camera [s]."""
MAX_SPREAD = 0.030
"""If exposures differ by more than this [m], they saw different surfaces at an edge. Their mean lies on neither
surface, so the median is used."""


def mean_depth(exposures: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the mean (H, W) of depth images of the same size [m]; NaN where fewer than half of the images are
    valid."""
    if len(exposures) == 1:
        return exposures[0]
    depth = np.stack(exposures)
    valid = np.isfinite(depth)
    count = valid.sum(axis=0)
    known = 2 * count >= len(depth)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(valid, depth, 0.0).sum(axis=0, dtype=np.float64) / count
        edge = known & (np.fmax.reduce(depth) - np.fmin.reduce(depth) > MAX_SPREAD)
    middle = (count[edge] - 1) // 2  # sorting puts NaN last
    mean[edge] = np.take_along_axis(np.sort(depth[:, edge], axis=0), middle[None], axis=0)[0]
    mean[~known] = np.nan
    return frozen(mean.astype(np.float32))
