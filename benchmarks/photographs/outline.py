"""An outline from corners: edges are slightly curved, corners are rounded as cloth rounds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

SAMPLES = 60
"""Points on an edge."""


@dataclass(frozen=True)
class Corner:
    """A corner and the edge that leaves it. radius [m]: of its rounding. bow [m]: how far the middle of the edge
    to the next corner stands to the left of the straight line. name: key point, or None."""

    name: str | None
    point: tuple[float, float]
    radius: float
    bow: float = 0.0


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


def trace(corners: list[Corner]) -> tuple[Points, dict[str, Points], list[Points]]:
    """The closed outline, the key points on it, and its edges (edge i leaves corner i).

    A key point is the middle of its rounded corner, because no cloth is where the edges would meet.
    """
    points = [np.array(corner.point) for corner in corners]
    following = points[1:] + points[:1]
    edges = [edge(p, q, c.bow) for c, p, q in zip(corners, points, following, strict=True)]
    trimmed = []
    for i, line in enumerate(edges):
        run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        last = run[-1] - corners[(i + 1) % len(corners)].radius
        at = np.linspace(corners[i].radius, last, SAMPLES)
        trimmed.append(np.column_stack([np.interp(at, run, line[:, k]) for k in (0, 1)]))
    outline, keypoints = [], {}
    for i, corner in enumerate(corners):
        arc = bezier(trimmed[i - 1][-1], points[i], trimmed[i][0], 9)
        if corner.name is not None:
            keypoints[corner.name] = arc[4]
        outline += [arc, trimmed[i]]
    return np.vstack(outline), keypoints, trimmed
