"""Classifies a silhouette by its aligned overlap with every template.

The aligned overlap is the intersection over union of the silhouette and a template that was placed on it and bent.
A template is placed in the orientations that the silhouette's moments and its smallest enclosing rectangle
suggest. The template is then bent a little at its key points: the registration runs for one round only
(`updates=1`), and its stretching and bending energy is measured from the unbent template. Thus a sleeve can swing,
but a towel does not become trousers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import GarmentOutline, MemberOutline, counter_clockwise, polygon_area
from foldcell.skills.perception.registration.energy import Boundary, EnergyWeights
from foldcell.skills.perception.registration.register import FitSettings, best_starts, fit

_STIFF = FitSettings(
    weights=EnergyWeights(kappa=0.2, beta=0.05),
    longest=10.0,  # no new vertices: a template bends at its key points only
    shortest=0.0,
    updates=1,
)
_CANDIDATES = 2
"""Number of orientations of a template that are compared."""
_MIN_OVERLAP = 0.6
"""If the overlap of the unbent template is not above this, the template cannot match and is not bent."""
_CELL = 0.004
"""Edge length of the raster cells in which overlaps are counted [m]."""


@dataclass(frozen=True)
class Match:
    """A garment's template compared with the silhouette. iou: intersection over union (0..1) after alignment.
    scale: observed over nominal size."""

    garment: GarmentOutline
    iou: float
    scale: float


def classify(contour: Array, templates: Sequence[GarmentOutline]) -> tuple[Match, ...]:
    """Rank templates for an observed boundary (n, 2) [m], best first.

    The templates are ordered by overlap. Templates with nearly the same overlap (within 0.02, such as towels of
    two sizes) are ordered by similarity of size. The caller decides whether the best match is good enough.
    """
    contour = counter_clockwise(contour)
    boundary = Boundary(contour, step=0.003, sample_step=0.015)
    matches = [_match(contour, boundary, template) for template in templates]
    best = max((m.iou for m in matches), default=0.0)
    return tuple(sorted(matches, key=lambda m: _sort_key(m, best)))


def _sort_key(match: Match, best: float) -> tuple[int, float, str]:
    if match.iou >= best - 0.02:
        return 0, abs(float(np.log(match.scale))), match.garment.name
    return 1, -match.iou, match.garment.name


def _match(contour: Array, boundary: Boundary, garment: GarmentOutline) -> Match:
    polygon = counter_clockwise(garment.template)
    scale = float(np.sqrt(polygon_area(contour) / polygon_area(polygon)))
    if isinstance(garment, MemberOutline):
        return Match(garment, polygon_iou(garment.placed, contour), scale)
    iou = 0.0
    for start in best_starts(polygon, boundary, _CANDIDATES):
        overlap = polygon_iou(start.polygon, contour)
        if _MIN_OVERLAP < overlap < 0.97:
            overlap = max(overlap, polygon_iou(fit(start.polygon, boundary, _STIFF)[0], contour))
        iou = max(iou, overlap)
    return Match(garment, iou, scale)


def polygon_iou(a: Array, b: Array) -> float:
    """Compute the intersection over union of two closed polygons (n, 2) [m], counted in cells of 4 x 4 mm."""
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
