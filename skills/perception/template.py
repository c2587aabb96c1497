"""The interface to the garment data that perception needs (name, category, outline with named corners), and
functions of such outlines."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from robots.ports import Array

__all__ = ["GarmentOutline", "polygon_area", "symmetries"]

_MAX_MOMENT_RATIO = 0.9
"""An outline whose smaller second moment is more than this share of the larger has no distinct principal axes."""


class GarmentOutline(Protocol):
    """The part of a garment that perception uses; the full type is in `skills.garments`.

    template: (k, 2) outline at nominal size [m], centred on 0, in the orientation in which the garment is laid
    (axes of the table frame). Its vertices are the key points, in the order of `keypoints`.
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
    """Signed area of a closed polygon (k, 2), in the square of its unit: positive when it runs
    counter-clockwise."""
    x, y = np.asarray(polygon, dtype=float).T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)


def symmetries(polygon: Array, tolerance: float = 0.03) -> tuple[str, ...]:
    """Return the names of a silhouette's symmetries, which make its orientation ambiguous in every picture.

    'rotated_90', 'rotated_180': it coincides with itself after this rotation about the centroid. 'mirrored': it
    coincides with its mirror image after a rotation (front and back look alike). tolerance: maximum distance
    between two boundaries that coincide, relative to the polygon's diagonal.
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

    These are the axes of its second moments. If the moments are equal in all directions, as for a square, every
    direction is such an axis. The directions of the corners and of the edges' midpoints are then added.
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
