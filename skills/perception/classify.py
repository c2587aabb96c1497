"""Which garment a silhouette belongs to: aligned overlap with every template.

Each template is laid over the silhouette in every orientation that moments suggest, bent a little at
its key points (one update of the registration with the template as reference, so that a sleeve may swing but
a towel does not become trousers), and compared by intersection over union.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.registration.energy import Boundary, EnergyWeights
from skills.perception.registration.register import RegistrationSettings, bend, best_starts
from skills.perception.template import GarmentOutline, polygon_area

__all__ = ["Match", "classify", "polygon_iou"]

_STIFF = RegistrationSettings(
    weights=EnergyWeights(kappa=0.2, beta=0.05),
    longest=10.0,  # no new vertices: a template bends at its key points only
    shortest=0.0,
    updates=1,
    candidates=2,
)
_HOPELESS = 0.6
"""Overlap from which bending makes no match."""
_CELL = 0.004
"""Edge of a raster cell in which overlaps are counted [m]."""


@dataclass(frozen=True)
class Match:
    """One candidate. iou: 0..1 after alignment. scale: observed size / nominal. angle: of the template [rad]."""

    name: str
    category: str
    iou: float
    scale: float
    angle: float


def classify(contour: Array, templates: Sequence[GarmentOutline]) -> tuple[Match, ...]:
    """Rank templates for an observed boundary (n, 2) [m], best first.

    By overlap; templates that overlap equally well (within 0.02: towels of two sizes) by nearness of size.
    Whether the best is good enough is the caller's question: an unknown garment has no good match.
    """
    contour = np.asarray(contour, dtype=float)
    if polygon_area(contour) < 0:
        contour = contour[::-1]
    boundary = Boundary(contour, step=0.003, sample_step=0.015)
    matches = [_match(contour, boundary, template) for template in templates]
    best = max((m.iou for m in matches), default=0.0)
    return tuple(sorted(matches, key=lambda m: _order(m, best)))


def _order(match: Match, best: float) -> tuple[int, float, str]:
    if match.iou >= best - 0.02:
        return 0, abs(float(np.log(match.scale))), match.name
    return 1, -match.iou, match.name


def _match(contour: Array, boundary: Boundary, garment: GarmentOutline) -> Match:
    polygon = np.asarray(garment.template, dtype=float)
    polygon = polygon[::-1] if polygon_area(polygon) < 0 else polygon
    scale = float(np.sqrt(polygon_area(contour) / polygon_area(polygon)))
    iou, angle = 0.0, 0.0
    for start in best_starts(polygon, boundary, _STIFF):
        overlap = polygon_iou(start.polygon, contour)
        if _HOPELESS < overlap < 0.97:
            overlap = max(overlap, polygon_iou(bend(start.polygon, boundary, _STIFF), contour))
        if overlap > iou:
            iou, angle = overlap, start.angle
    return Match(garment.name, garment.category, iou, scale, angle)


def polygon_iou(a: Array, b: Array) -> float:
    """Intersection over union of two closed polygons (n, 2) [m], counted in cells of 4 mm."""
    low = np.minimum(a.min(axis=0), b.min(axis=0)) - _CELL
    high = np.maximum(a.max(axis=0), b.max(axis=0)) + _CELL
    shape = tuple(np.ceil((high - low) / _CELL).astype(int) + 1)
    first, second = _raster(a, low, shape), _raster(b, low, shape)
    union = np.count_nonzero(first | second)
    return float(np.count_nonzero(first & second) / union) if union else 0.0


def _raster(polygon: Array, low: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    image = np.zeros(shape, np.uint8)
    cells = np.round((polygon - low)[:, ::-1] / _CELL * 16).astype(np.int32)
    cv2.fillPoly(image, [cells], 1, shift=4)
    return image > 0
