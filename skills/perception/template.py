"""The garment data that perception needs: name, category and outline with named corners."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from robots.ports import Array

__all__ = ["GarmentOutline", "polygon_area", "symmetries"]

_MAX_MOMENT_RATIO = 0.9
"""Ratio of second moments above which an outline has no distinct principal axes."""


class GarmentOutline(Protocol):
    """The interface of a garment for perception; `skills.garments` has the full type.

    template: (k, 2) [m] at nominal size, centred on 0, in its laid orientation (table frame's axes). Its vertices
    are the key points, in the order of `keypoints`.
    """

    @property
    def name(self) -> str: ...

    @property
    def category(self) -> str: ...

    @property
    def keypoints(self) -> tuple[str, ...]: ...

    @property
    def template(self) -> Array: ...


def polygon_area(polygon: Array) -> float:
    """Signed area of a closed polygon (k, 2): positive when it runs counter-clockwise [unit^2]."""
    x, y = np.asarray(polygon, dtype=float).T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)


def symmetries(polygon: Array, tolerance: float = 0.03) -> tuple[str, ...]:
    """The symmetries of a silhouette that no picture of it can resolve, by name.

    'rotated_90' and 'rotated_180' are about the centroid. 'mirrored' means that a mirror image coincides with it
    after a rotation (front and back look alike). tolerance: maximum boundary distance, relative to the polygon's
    diagonal.
    """
    outline = _resample(polygon, 200)
    outline = outline - _centroid(polygon)
    max_distance = tolerance * float(np.linalg.norm(np.ptp(outline, axis=0)))
    tree = cKDTree(outline)

    def coincides(image: Array) -> bool:
        return bool(tree.query(image)[0].max() <= max_distance)

    rotations = (("rotated_90", np.pi / 2), ("rotated_180", np.pi))
    names = [name for name, angle in rotations if coincides(outline @ _rotation(angle).T)]
    mirrored = outline * np.array([1.0, -1.0])
    corners = np.asarray(polygon, dtype=float) - _centroid(polygon)
    if any(coincides(mirrored @ _rotation(2.0 * axis).T) for axis in _mirror_axes(outline, corners)):
        names.append("mirrored")
    return tuple(names)


def _mirror_axes(outline: Array, corners: Array) -> list[float]:
    """Directions [rad] through the centroid that can be mirror axes of an outline (n, 2) with corners (k, 2).

    They are the axes of its second moments. If these are equal in all directions, as for a square, every direction
    is such an axis. Candidates are then the directions of the corners and of the edges' midpoints.
    """
    moments, axes = np.linalg.eigh(np.cov(outline.T))
    long = float(np.arctan2(axes[1, 1], axes[0, 1]))
    found = [long, long + 0.5 * np.pi]
    if moments[0] > _MAX_MOMENT_RATIO * moments[1]:
        ends = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=0))])
        found += np.arctan2(ends[:, 1], ends[:, 0]).tolist()
    return found


def _rotation(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _centroid(polygon: Array) -> Array:
    next_vertex = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * next_vertex[:, 1] - next_vertex[:, 0] * polygon[:, 1]
    return ((polygon + next_vertex) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())


def _resample(polygon: Array, n: int) -> Array:
    closed = np.vstack([polygon, polygon[:1]])
    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))]
    s = np.linspace(0.0, arc[-1], n, endpoint=False)
    return np.stack([np.interp(s, arc, closed[:, 0]), np.interp(s, arc, closed[:, 1])], axis=1)
