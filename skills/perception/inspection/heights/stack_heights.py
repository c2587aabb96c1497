"""Measures the heights of a folded garment as the score measures them: away from its creases and near them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robots.ports import Array
from skills.perception.rectification.heights import smooth_height
from skills.perception.rectification.table_view import TableView

__all__ = ["StackHeights", "stack_heights"]

WINDOW = 5
"""Side of the square over which the height is averaged [px]. The camera's noise in single pixels would raise the
95th percentile; a larger square would lower the crest of a crease."""
FEWEST = 100
"""Fewest pixels of which a percentile is taken."""


@dataclass(frozen=True)
class StackHeights:
    """95th percentiles of the height above the table [m]; NaN where too little is visible.

    height_m: over the silhouette away from all creases, or over all of it if it lies near creases everywhere.
    crease_height_m: over the silhouette near creases.
    """

    height_m: float
    crease_height_m: float


def stack_heights(
    height: NDArray[np.float32], mask: NDArray[np.bool_], view: TableView, creases: Array, margin: float
) -> StackHeights:
    """Measure the heights of a garment. height: (H, W) above the table [m], NaN where unknown, and mask: (H, W) of
    its silhouette, both in `view`. creases: (k, 2) points of all creases of the plan as they lie now [m]. margin:
    distance from a crease up to which cloth is near it [m].

    Each pixel counts at the place of the cloth that it shows, which its height determines.
    """
    smooth = smooth_height(height, WINDOW)
    rows, columns = np.nonzero(mask & np.isfinite(height) & np.isfinite(smooth))
    values = smooth[rows, columns].astype(float)
    if not len(creases):
        return StackHeights(_upper(values), float("nan"))
    places = view.to_table(np.stack([columns, rows], axis=1), values)
    distance, _ = cKDTree(creases).query(places, distance_upper_bound=margin)
    near = np.isfinite(distance)
    away = values[~near]
    return StackHeights(_upper(away if len(away) >= FEWEST else values), _upper(values[near]))


def _upper(values: Array) -> float:
    return float(np.quantile(values, 0.95)) if len(values) >= FEWEST else float("nan")
