"""From places in a picture of a garment to its outline in metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen

SYMMETRIC = 0.002
"""A template whose points differ from their mirror images by less than this is symmetric [m]."""


def as_laid(pixels: Array) -> Array:
    """Turn places (n, 2) in a picture (column, row) into the laid pose: up is forward (x), left is left (y)."""
    return -pixels[:, ::-1]


@dataclass(frozen=True, eq=False)
class PictureMeasure:
    """The size of a picture and the scale of what it shows.

    columns, rows: of the picture [px]. to_laid: converts places (n, 2) in it [px] to the laid pose, in any unit.
    measured: indices of the two key points that lie `length` [m] apart; None if `to_laid` gives metres.
    """

    columns: int
    rows: int
    measured: tuple[int, int] | None
    length: float | None
    to_laid: Callable[[Array], Array] = as_laid

    def template(self, pixels: Array, like: Array) -> Array:
        """Return the template (k, 2) [m] of a garment with key points at `pixels` (k, 2) [px]. like: (k, 2)
        template of a similar garment. Raises ValueError for points that give no scale."""
        return fitted_template(self.to_laid(pixels), like, self.measured, self.length)


def fitted_template(seen: Array, template: Array, measured: tuple[int, int] | None, length: float | None) -> Array:
    """Compute the outline (k, 2) [m] of a garment from its detected key points `seen` (k, 2), centred and rotated
    like `template` (k, 2).

    measured, length: indices of two key points and their distance on the garment [m], which give the scale of
    `seen`; None if `seen` is in metres. A tilted camera or the garment's pose can make the two halves of a
    symmetric garment unequal. If the template is symmetric, the two halves are therefore averaged. The rotation is
    Kabsch's (1976), in the plane. Raises ValueError for a length or points that give no scale.
    """
    points = np.asarray(seen, dtype=float)
    if measured is not None and length is not None:
        apart = float(np.linalg.norm(points[measured[0]] - points[measured[1]]))
        if not (np.isfinite(apart) and apart > 0.0 and length > 0.0):
            raise ValueError(f"points {apart:g} apart and a length of {length:g} m make no scale")
        points = points * (length / apart)
    points = (points - points.mean(axis=0)) @ _turn(points, template).T
    twins = mirror_images(template)
    if twins is not None:
        points = 0.5 * (points + points[twins] * [1.0, -1.0])
    return frozen(points - 0.5 * (points.min(axis=0) + points.max(axis=0)))


def mirror_images(template: Array) -> NDArray[np.intp] | None:
    """Return, for each point of a template (k, 2), the index of its mirror image about the x axis, (k,); None if
    the template is not symmetric."""
    apart = np.linalg.norm(template[:, None] - (template * [1.0, -1.0])[None], axis=2)
    twins = np.asarray(np.argmin(apart, axis=1))
    alike = apart[np.arange(len(twins)), twins].max() < SYMMETRIC and len(set(twins.tolist())) == len(twins)
    return twins if alike else None


def _turn(points: Array, template: Array) -> Array:
    """Return the rotation (2, 2) that best aligns `points` with `template`, both about their means."""
    a, b = points - points.mean(axis=0), template - template.mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
