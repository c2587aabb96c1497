"""Measures how the garment has moved between two pictures: before a plan is carried out, the cell compares the
picture that the plan was made from with a fresh one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.registration.alignment import align, edge_deviation
from foldcell.skills.perception.segmentation.mask import Mask
from foldcell.skills.perception.segmentation.reference import segment_reference
from foldcell.skills.perception.segmentation.table_model import KNOWN_SHARE
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.perception.silhouette import find_silhouette
from foldcell.skills.perception.views import Views
from foldcell.skills.vocabulary import Outcome

_WINDOW = 15
"""Side of the square over which heights are averaged before they are compared [px]."""
_RISE = 0.008
"""A place whose height has changed by more than this counts as changed [m]: five times the noise of the mean."""

_ARM_HEIGHT = 0.020
"""A place that is higher than in the earlier picture by more than this shows an arm [m]."""
_ARM_MARGIN = 0.050
"""The boundary is not judged nearer than this to an arm, where depth is missing and shadows are deep [m]."""
_DISPLACED = 0.015
"""A place of the boundary is displaced if no boundary is left within this distance [m]."""


@dataclass(frozen=True, eq=False)
class GarmentMotion:
    """The motion of a garment between two pictures.

    R (2, 2), t (2,) [m]: the rigid motion p -> R p + t that aligns the earlier outline with the later one.
    moved_m: largest displacement of a point of the outline by this motion [m]. turned_rad: angle of the motion
    [rad]. deviation_m: deviation that remains between the outlines after this motion [m]. reshaped_m2: area inside
    the outline whose height has changed [m2]; 0 if the outline itself has moved.
    """

    R: Array
    t: Array
    moved_m: float
    turned_rad: float
    deviation_m: float
    reshaped_m2: float

    def says(self) -> str:
        """Describe the motion for the operator."""
        turn = (
            f" and turned by {np.rad2deg(abs(self.turned_rad)):.0f} degrees" if abs(self.turned_rad) > 0.02 else ""
        )
        return f"moved by {self.moved_m * 1e3:.0f} mm{turn}"


def measure_motion(before: Views, after: Views, settings: PerceptionSettings) -> Outcome[GarmentMotion]:
    """Compare the garment's outlines in two pictures of one view. Both outlines are found in the same way, so that
    errors that they share cancel.

    Failures: those of `find_silhouette`, for the later picture first.
    """
    found = [find_silhouette(views, settings) for views in (after, before)]
    for outcome in found:
        if outcome.failure:
            return Outcome(failure=outcome.failure)
    later, earlier = (outcome.unwrap() for outcome in found)
    outline, observed = (before.view.to_table(s.contour) for s in (earlier, later))
    R, t = align(outline, observed)
    aligned = outline @ R.T + t
    moved = float(np.linalg.norm(aligned - outline, axis=1).max())
    deviation, _ = edge_deviation(aligned, observed)
    both = earlier.mask & later.mask
    reshaped = _reshaped(before, after, both) if moved < _RISE else 0.0
    return Outcome(GarmentMotion(R, t, moved, float(np.arctan2(R[1, 0], R[0, 0])), abs(deviation), reshaped))


def displaced_boundary(before: Views, after: Views, settings: PerceptionSettings) -> float:
    """Return the length of the garment's boundary that is visible between the arms and has left its place [m].

    before: a picture without arms; after: a later one, with the arms over the table. The result is 0 if the
    garment is not found in the earlier picture, or if there is no picture of the empty table: without it, arms and
    garment cannot be told apart.
    """
    if after.empty is None or (earlier := find_silhouette(before, settings).value) is None:
        return 0.0
    pixel, size = before.view.pixel, 2 * round(_ARM_MARGIN / before.view.pixel) + 1
    height = smooth_height(after.seen.height, 9, KNOWN_SHARE)
    earlier_height = np.nan_to_num(smooth_height(before.seen.height, 9, least_known=0.0))
    higher = ~(height - earlier_height <= _ARM_HEIGHT)  # also where the height is not known
    arms = cv2.morphologyEx(higher.astype(np.uint8), cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    hidden = (cv2.dilate(arms, np.ones((size, size), np.uint8)) > 0) | ~after.seen.valid
    found = segment_reference(after.seen.rgb, after.empty.rgb, after.seen.valid, after.height)
    cloth = (found.mask | found.others).astype(np.uint8)
    edge = cv2.morphologyEx(cloth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    distance = cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 5) * pixel
    column, row = np.round(earlier.contour).astype(int).T
    column, row = (np.clip(c, 0, n - 1) for c, n in zip((column, row), before.view.shape[::-1], strict=True))
    displaced = (distance[row, column] > _DISPLACED) & ~hidden[row, column]
    return float(np.count_nonzero(displaced)) * pixel


def _reshaped(before: Views, after: Views, where: Mask) -> float:
    """Return the area within a mask whose height has changed by more than `_RISE` [m2]."""
    a, b = (smooth_height(views.height, _WINDOW, KNOWN_SHARE) for views in (before, after))
    changed = where & (np.abs(b - a) > _RISE)
    opened = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    return float(np.count_nonzero(opened)) * before.view.pixel**2
