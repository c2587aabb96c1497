"""Implements the paper's method from a picture to key points, as published. It is the baseline of the comparison.

1. Marker-based watershed, with the corners as background and the centre as foreground.
2. The template of the garment, whose name is given, is placed on the mask by a similarity.
3. Registration with the paper's energy, which has only one data term (from contour to boundary). Corners are not
   relocated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from benchmarks.perception.scenes import TABLE, LabelledScene
from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import GarmentOutline, polygon_area, resample_closed, segment_lengths
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.energy import Boundary, EnergyWeights
from foldcell.skills.perception.registration.register import FitSettings, fit
from foldcell.skills.perception.segmentation.watershed import segment_watershed
from foldcell.skills.plane import rotation

SETTINGS = FitSettings(weights=replace(EnergyWeights(), cover=0.0), updates=40, reduction=0.01)


def paper_keypoints(scene: LabelledScene, garment: GarmentOutline) -> Mapping[str, Array]:
    """Find the key points, name -> (2,) [m]; empty if no region is found."""
    view = TableView(scene.calibration, TABLE)
    seen = view.rectify(scene.frame)
    found = segment_watershed(seen.rgb, seen.valid)
    if not found.found:
        return {}
    boundary = Boundary(view.to_table(found.contour))
    X, feature, _, _ = fit(_similar(np.asarray(garment.template), boundary.points), boundary, SETTINGS)
    return {garment.keypoints[feature[i]]: X[i] for i in np.flatnonzero(feature >= 0)}


def _similar(template: Array, observed: Array) -> Array:
    """Place the template (k, 2) by a similarity, so that centroid and area are the same and the long axes
    parallel. It is turned by at most a right angle."""
    scale = np.sqrt(polygon_area(observed) / polygon_area(template))
    turn = _axis(observed) - _axis(template)
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2
    moved = scale * (template - _centre(template)) @ rotation(turn).T
    return np.asarray(moved + _centre(observed))


def _axis(polygon: Array) -> float:
    _, axes = np.linalg.eigh(np.cov(_even(polygon).T))
    return float(np.arctan2(axes[1, 1], axes[0, 1]))


def _centre(polygon: Array) -> Array:
    return np.asarray(_even(polygon).mean(axis=0))


def _even(polygon: Array) -> Array:
    return resample_closed(polygon, float(segment_lengths(polygon).sum()) / 400)
