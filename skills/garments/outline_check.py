"""Rules for the outline of a garment, in garment files and as placed in a picture by a person."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import shapely

from foldcell.robots.ports import Array

SAME_PLACE = 0.002
"""Key points that are nearer than this lie at the same place, relative to the garment's size."""
SMALLEST, LARGEST = 0.05, 3.0
"""Smallest and largest extent of a garment [m]."""
LEAST_AREA = 1e-3
"""Smallest area of a garment [m^2]."""


def same_places(points: Array, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the pairs of key points that lie at the same place. points: (k, 2), in any unit."""
    limit = SAME_PLACE * float(np.linalg.norm(np.ptp(points, axis=0)))
    pairs = combinations(range(len(points)), 2)
    return [(names[i], names[k]) for i, k in pairs if np.linalg.norm(points[i] - points[k]) <= limit]


def crosses_itself(points: Array) -> bool:
    """Tell whether the outline through the points (k, 2) crosses or touches itself."""
    return not shapely.Polygon(points).is_valid


def runs_clockwise(points: Array) -> bool:
    """Tell whether the points (k, 2), x forward and y left, follow each other clockwise."""
    return not shapely.Polygon(points).exterior.is_ccw


def impossible_size(template: Array) -> bool:
    """Tell whether no garment has the extents or the area of this outline (k, 2) [m]."""
    size = np.ptp(template, axis=0)
    return bool(size.max() > LARGEST or size.min() < SMALLEST or shapely.Polygon(template).area < LEAST_AREA)
