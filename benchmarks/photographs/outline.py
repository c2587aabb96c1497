"""Curved edges of outlines and seams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

SAMPLES = 60
"""Points on an edge."""


def edge(start: Points, end: Points, bow: float) -> Points:
    """Points on a quadratic Bezier curve whose middle stands `bow` to the left of the straight line."""
    along = end - start
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    control = (start + end) / 2 + 2 * bow * normal
    return bezier(start, control, end, SAMPLES)


def bezier(start: Points, control: Points, end: Points, n: int) -> Points:
    """n points on a quadratic Bezier curve."""
    t = np.linspace(0.0, 1.0, n)[:, None]
    return (1 - t) ** 2 * start + 2 * t * (1 - t) * control + t**2 * end
