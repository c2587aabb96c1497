"""Compares an observed fold with the plan's target: overlap, drift and heights, as the score defines them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.inspection.predicted_view import draw_shape, mask_iou, move_view, outline_of
from foldcell.skills.perception.rectification.heights import smooth_height, upper
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.alignment import align
from foldcell.skills.vocabulary import PredictedShape

MOST_LIFT = 0.030
"""Largest height by which the target is raised to the height of the observed garment [m]."""
WINDOW = 5
"""Side of the square over which the height is averaged [px]. The camera's noise in single pixels would raise the
95th percentile; a larger square would lower the crest of a crease."""


@dataclass(frozen=True)
class StackHeights:
    """95th percentiles of the height above the table [m]; NaN where too little is visible.

    height_m: over the silhouette away from all creases, or over all of it if it lies near creases everywhere.
    crease_height_m: over the silhouette near creases. relief_m: how far `height_m` lies above the median of the
    same places.
    """

    height_m: float
    crease_height_m: float
    relief_m: float = 0.0


@dataclass(frozen=True, eq=False)
class FoldTarget:
    """The perfect fold. shape: its mesh, whose creases are as flat as its layers. creases: (k, 2) points of the
    creases of all folds so far [m]."""

    shape: PredictedShape
    creases: Array


@dataclass(frozen=True, eq=False)
class TargetView:
    """Comparison of the observed fold with the plan's target, the perfectly flat fold.

    iou: overlap of the two silhouettes after the rigid motion that aligns the target with the observation. This
    motion is p -> turned(p - about) + about + drift. about: (2,) centre of the target [m]; drift: (2,) its
    displacement [m]; drift_rad: angle of the motion [rad]. side: of a square with the area of the target
    [m]. The heights of the observed garment, of the prediction and of the target are above the table. Heights of
    meshes are those of the middle of the upper layer.
    """

    iou: float
    about: Array
    drift: Array
    drift_rad: float
    side: float
    observed: StackHeights
    predicted: StackHeights
    flat: StackHeights


def view_target(
    view: TableView,
    mask: NDArray[np.bool_],
    contour: Array,
    height: NDArray[np.float32],
    predicted: PredictedShape,
    target: FoldTarget,
    margin: float,
) -> TargetView:
    """Compare the observed fold with the target.

    mask: (H, W) observed silhouette, height: (H, W) above the table [m], NaN where unknown, both in `view`;
    contour: (n, 2) boundary of the silhouette [m]. margin: distance from a crease within which cloth counts as
    near it [m].

    The camera looks at an angle, so a high garment appears displaced. The target is therefore drawn at the
    observed garment's mean height. Raises ValueError if the target lies outside the view.
    """
    known = mask & np.isfinite(height)
    mean = float(height[known].mean()) if known.any() else 0.0
    shape, creases = target.shape, target.creases
    flat, expected = draw_shape(view, shape), draw_shape(view, predicted)
    lift = float(np.clip(mean - np.nanmean(flat), 0.0, MOST_LIFT))
    raised = PredictedShape(shape.vertices + np.array([0.0, 0.0, lift]), shape.triangles, shape.material)
    drawn = draw_shape(view, raised)
    outline = outline_of(view, np.isfinite(drawn))
    R, t = align(outline, contour)
    fitted = np.isfinite(move_view(view, drawn, R, t))
    about = shape.vertices[:, :2].mean(axis=0)

    def heights(image: NDArray[np.float32], where: NDArray[np.bool_], at: Array) -> StackHeights:
        return stack_heights(image, where, view, at, margin)

    return TargetView(
        iou=mask_iou(mask, fitted),
        about=frozen(about),
        drift=frozen(R @ about + t - about),
        drift_rad=float(np.arctan2(R[1, 0], R[0, 0])),
        side=view.pixel * math.sqrt(np.count_nonzero(np.isfinite(flat))),
        observed=heights(height, mask, creases @ R.T + t),
        predicted=heights(expected, np.isfinite(expected), creases),
        flat=heights(flat, np.isfinite(flat), creases),
    )


def stack_heights(
    height: NDArray[np.float32], mask: NDArray[np.bool_], view: TableView, creases: Array, margin: float
) -> StackHeights:
    """Measure the heights of a garment. height: (H, W) above the table [m], NaN where unknown, and mask: (H, W) of
    its silhouette, both in `view`. creases: (k, 2) points of all creases of the plan as they lie now [m]. margin:
    distance from a crease up to which cloth is near it [m].

    Each pixel counts at the place of the cloth that it shows, which its height determines.
    """
    smooth = smooth_height(height, WINDOW)
    rows, columns = np.nonzero(mask & np.isfinite(height) & np.isfinite(smooth))
    values = smooth[rows, columns].astype(float)
    if not len(creases):
        return StackHeights(upper(values), float("nan"))
    places = view.to_table(np.stack([columns, rows], axis=1), values)
    distance, _ = cKDTree(creases).query(places, distance_upper_bound=margin)
    near = np.isfinite(distance)
    judged = values[~near] if np.isfinite(upper(values[~near])) else values
    top = upper(judged)
    return StackHeights(top, upper(values[near]), top - float(np.median(judged)) if np.isfinite(top) else 0.0)
