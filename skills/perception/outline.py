"""The outline of a garment, and the geometry of closed polygons and contours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from foldcell.robots.ports import Array
from foldcell.skills.plane import cross, lengths_along, rotation

_MAX_MOMENT_RATIO = 0.9
"""An outline whose smaller second moment is more than this share of the larger has no distinct principal axes."""


class GarmentOutline(Protocol):
    """The part of a garment that perception uses; the full type is in `foldcell.skills.garments`.

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


@dataclass(frozen=True, eq=False)
class MemberOutline:
    """The outline of a garment with another shape of its category; see `GarmentOutline`.

    placed: (n, 2) where it lies on an observed boundary, counter-clockwise: the key points and further bends
    between them [m]. feature: (n,) index of the key point of each of them, -1 for a bend. strain: how unusual its
    figures are, as the mean square of their deviations in standard deviations. unusual: the same of its
    proportions alone: shear and bends are how cloth lies. turned: probability that it lies the other way round.
    """

    name: str
    category: str
    keypoints: tuple[str, ...]
    template: Array
    placed: Array
    feature: NDArray[np.intp]
    strain: float
    unusual: float = 0.0
    turned: float = 0.0


def polygon_area(polygon: Array) -> float:
    """Signed area of a closed polygon (k, 2), in the square of its unit: positive when it runs
    counter-clockwise."""
    x, y = np.asarray(polygon, dtype=float).T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)


def counter_clockwise(polygon: Array) -> Array:
    """Return the polygon (k, 2) so that it runs counter-clockwise: as it is, or reversed."""
    polygon = np.asarray(polygon, dtype=float)
    return polygon[::-1] if polygon_area(polygon) < 0 else polygon


def segment_lengths(X: Array) -> Array:
    """Lengths (n,) of a closed contour's segments; segment i runs from vertex i to i + 1."""
    edge = np.concatenate((X[1:], X[:1])) - X
    return np.asarray(np.sqrt(edge[:, 0] ** 2 + edge[:, 1] ** 2))


def interior_angles(X: Array) -> Array:
    """Interior angles (n,) in (0, 2 pi) of a counter-clockwise contour (n, 2)."""
    u = np.concatenate((X[1:], X[:1])) - X
    v = np.concatenate((X[-1:], X[:-1])) - X
    return np.mod(np.arctan2(cross(u, v), (u * v).sum(axis=1)), 2 * np.pi)


def outward_normals(points: Array) -> Array:
    """Outward unit normals (n, 2) of a closed contour, whether it runs clockwise or not. They are taken from the
    second neighbour on each side."""
    tangent = np.roll(points, -2, axis=0) - np.roll(points, 2, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) * (1.0 if polygon_area(points) > 0 else -1.0)


def resample_closed(points: Array, step: float) -> Array:
    """Resample a closed polygon (n, 2) evenly, with points about `step` apart, but at least eight."""
    closed = np.vstack([points, points[:1]])
    arc = lengths_along(closed)
    s = np.linspace(0.0, arc[-1], max(round(arc[-1] / step), 8), endpoint=False)
    return np.stack([np.interp(s, arc, closed[:, 0]), np.interp(s, arc, closed[:, 1])], axis=1)


def smooth_closed(values: Array, sigma: float) -> Array:
    """Smooth a closed sequence along its first axis by a Gaussian. sigma: in samples."""
    reach = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    if len(values) <= 2 * reach:
        return values
    flat: Array = values.reshape(len(values), -1).astype(np.float64)
    padded = np.concatenate([flat[-reach:], flat, flat[:reach]])
    smoothed: Array = np.asarray(cv2.filter2D(padded, -1, kernel[:, None]), dtype=np.float64)[reach:-reach]
    return smoothed.reshape(values.shape)


def symmetries(polygon: Array, tolerance: float = 0.03) -> tuple[str, ...]:
    """Return the names of a silhouette's symmetries, which make its orientation ambiguous in every picture.

    'rotated_90', 'rotated_180': it coincides with itself after this rotation about the centroid. 'mirrored': it
    coincides with its mirror image after a rotation (front and back look alike). tolerance: maximum distance
    between two boundaries that coincide, relative to the polygon's diagonal.
    """
    centroid = np.array(shapely.Polygon(polygon).centroid.coords[0])
    outline = resample_closed(polygon, float(segment_lengths(polygon).sum()) / 200) - centroid
    max_distance = tolerance * float(np.linalg.norm(np.ptp(outline, axis=0)))
    tree = cKDTree(outline)

    def coincides(image: Array) -> bool:
        return bool(tree.query(image)[0].max() <= max_distance)

    rotations = (("rotated_90", np.pi / 2), ("rotated_180", np.pi))
    names = [name for name, angle in rotations if coincides(outline @ rotation(angle).T)]
    mirrored = outline * np.array([1.0, -1.0])
    axes = _mirror_axes(outline, np.asarray(polygon, dtype=float) - centroid)
    if any(coincides(mirrored @ rotation(2.0 * axis).T) for axis in axes):
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
