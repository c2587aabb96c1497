"""Locates the ends of a shirt's collar at the neckline, which runs from one to the other across the cloth.

A shirt that lies flat shows the inside of its back through the opening of the neck. The outline hardly bends where
the opening ends, but along the front edge of the neck the colour changes. Arcs between two places of the upper
edge, with several depths, are compared with the picture: along a neckline, the colours on both sides differ in the
same way at nearly every place. A print or a crease has no such arc that ends at the edge on both sides.
"""

from __future__ import annotations

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture

# Lengths are relative to the square root of the garment's area.
_AXIS, _HALF, _DEPTH = (-0.10, 0.101, 0.01), (0.07, 0.25, 0.01), (0.045, 0.30, 0.015)
"""Places of the arc's middle beside the body's axis, half widths of it, and depths: from, to, step."""
_ROUND = (0.6, 1.0)
"""Exponents of the arc: a U, and a parabola."""
_ENDS = 0.10
"""Share of the arc, at each end, that is not compared: it lies too near the outline."""
_BESIDE, _CLOTH = 0.012, 0.009
"""Distance between the places on both sides of the arc whose colours are compared, and distance within the arc at
which there is cloth."""
_SAMPLES = 28
_NOISE = 1.5
"""Standard deviation of the noise of a difference of colours [grey levels]."""
_EVIDENCE, _COMPLETE, _AGREES = 45.0, 0.85, 0.3
"""Least evidence for a neckline: the number of places times the square of their median difference, relative to its
spread. Least share of places that agree, with at least the third share of the median difference."""
_BESIDE_AXIS, _USUAL = 0.06, (0.15, 0.04)
"""Standard deviation of the arc's middle from the body's axis; mean and standard deviation of its half width. The
evidence for another arc is less."""
_RIVAL, _ELSEWHERE = 0.6, 0.04
"""Another arc, at least the second away, must have less than this share of the evidence."""


def locate_neckline(
    picture: ClothPicture, edge: Array, frame: Array, origin: Array, middle: float
) -> tuple[float, float] | None:
    """Return the place of the neckline's axis and its half width; None if there is none, or more than one.

    edge: (n, 2) upper edge, height and place across, in a frame with the axes `frame` (2, 2), as columns [m], and
    the origin (2,) [m]. middle: place of the body's axis.
    """
    order = np.argsort(edge[:, 1], kind="stable")
    y, b = edge[order].T
    tried = np.meshgrid(
        middle + np.arange(*_AXIS), *(np.arange(*s) for s in (_HALF, _DEPTH)), _ROUND, indexing="ij"
    )
    arcs = np.stack(tried, axis=-1).reshape(-1, 4)
    arcs = arcs[(arcs[:, 0] - arcs[:, 1] > b[0]) & (arcs[:, 0] + arcs[:, 1] < b[-1])]
    if not len(arcs):
        return None
    axis, half, depth, power = arcs.T[..., None]
    first, second = np.interp(axis + half, b, y), np.interp(axis - half, b, y)
    u = np.cos(np.linspace(_ENDS, 1.0 - _ENDS, _SAMPLES) * np.pi)
    shape = (1.0 - np.abs(u) ** (2.0 / power)) ** power

    def places(inwards: float) -> Array:
        """The arcs (m, samples, 2) [m], narrower and less deep."""
        height = 0.5 * (first + second) + 0.5 * u * (first - second) - (depth - inwards) * shape
        return origin + np.stack([height, axis + (half - inwards) * u], axis=-1) @ frame.T

    step = picture.colours(places(-0.5 * _BESIDE)) - picture.colours(places(0.5 * _BESIDE))
    median = np.median(step, axis=1)
    size = np.maximum(np.linalg.norm(median, axis=1), 1e-6)
    along = (step @ (median / size[:, None])[..., None])[..., 0]
    spread = 1.4826 * np.median(np.abs(along - size[:, None]), axis=1) + _NOISE
    cloth = picture.cloth(places(_CLOTH)) > 0.99
    agree = np.mean((along > _AGREES * size[:, None]) & cloth, axis=1)
    unusual = ((arcs[:, 0] - middle) / _BESIDE_AXIS) ** 2 + ((arcs[:, 1] - _USUAL[0]) / _USUAL[1]) ** 2
    usual = np.exp(-0.5 * unusual)
    evidence = np.where(agree > _COMPLETE, usual * _SAMPLES * (size / spread) ** 2, 0.0)
    best = int(np.argmax(evidence))
    away = np.abs(arcs[:, :2] - arcs[best, :2]).sum(axis=1) > _ELSEWHERE
    if evidence[best] < _EVIDENCE or (away & (evidence > _RIVAL * evidence[best])).any():
        return None
    return float(arcs[best, 0]), float(arcs[best, 1])
