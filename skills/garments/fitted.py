"""A garment's own template from key points that were seen of it and one length that was measured on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen

__all__ = ["fitted_template", "mirror_images"]

SYMMETRIC = 0.002
"""Templates whose mirror image differs by less than this are symmetric [m]."""


def fitted_template(seen: Array, template: Array, measured: tuple[int, int] | None, length: float | None) -> Array:
    """(k, 2) [m] the outline of the garment of which the key points `seen` (k, 2) were found, turned as `template`
    (k, 2) is and centred.

    measured, length: two key points and how far apart they are on the garment [m]; None: `seen` is in metres.
    Where the template is its own mirror image the result is too: halves that a tilted camera, or the way in which
    the garment was laid, made unequal are averaged. The turn is Kabsch's (1976), in the plane. Raises ValueError
    for a length or points that make no scale.
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
    """(k,) of each point of a template (k, 2) the one that is its mirror image over the x axis; None where it is
    not symmetric."""
    apart = np.linalg.norm(template[:, None] - (template * [1.0, -1.0])[None], axis=2)
    twins = np.asarray(np.argmin(apart, axis=1))
    alike = apart[np.arange(len(twins)), twins].max() < SYMMETRIC and len(set(twins.tolist())) == len(twins)
    return twins if alike else None


def _turn(points: Array, template: Array) -> Array:
    """(2, 2) the rotation that lays `points` on `template` best, both about their means."""
    a, b = points - points.mean(axis=0), template - template.mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
