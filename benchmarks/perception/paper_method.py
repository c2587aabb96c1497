"""Implements the paper's method from a picture to key points, as published. It is the baseline of the comparison.

1. Marker-based watershed (Vincent and Soille 1991), with the corners as background and the centre as foreground.
2. The template of the garment, whose name is given, is placed on the mask by a similarity.
3. Registration with the paper's energy, which has only one data term (from contour to boundary). Corners are not
   relocated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from benchmarks.perception.scenes import TABLE, LabelledScene
from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import GarmentOutline, polygon_area, resample_closed, segment_lengths
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.energy import Boundary, EnergyWeights
from foldcell.skills.perception.registration.register import FitSettings, fit
from foldcell.skills.perception.segmentation.mask import Image, Mask, Segmentation, outlined
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


def segment_watershed(rgb: Image, valid: Mask) -> Segmentation:
    """Segment rgb (H, W, 3) where valid (H, W). The four corners are assumed to be background, the centre
    garment."""
    rows, columns = np.nonzero(valid)
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    radius = max(min(bottom - top, right - left) // 20, 2)
    markers = np.zeros(valid.shape, np.int32)
    for row in (top + radius, bottom - radius):
        inside = np.flatnonzero(valid[row])
        for column in (inside[0] + radius, inside[-1] - radius):
            cv2.circle(markers, (int(column), int(row)), int(radius), 1, -1)
    cv2.circle(markers, (int(left + right) // 2, int(top + bottom) // 2), int(radius), 2, -1)
    markers[~valid] = 1
    labels = cv2.watershed(np.ascontiguousarray(cv2.medianBlur(rgb, 5)), markers)
    return outlined(labels == 2, rgb, valid)


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
