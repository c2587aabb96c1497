"""The result of an inspection, and its thresholds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.inspection.claim import ClaimSettings
from foldcell.skills.perception.inspection.moved_edge import MovedEdge
from foldcell.skills.perception.inspection.target_view import TargetView
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.vocabulary import FailureKind

MAX_PILED_AREA = 0.0012
"""Maximum area that is more than `extra_height` higher than predicted."""
FOLD_MARGIN = 0.040
"""Nearer than this to a fold line, heights are not judged, because the crease bulges there."""


@dataclass(frozen=True, kw_only=True)
class InspectionSettings:
    """Limits of the cell's settings: a fold within all of them counts as predicted. Lengths [m], angles [rad].
    Constants stand beside the functions that use them."""

    iou: float
    """Minimum overlap with the prediction after rigid alignment."""
    drift: float
    drift_angle: float
    extra_height: float
    deviation: float
    """Maximum distance between observed and predicted boundary after alignment."""
    perception: PerceptionSettings
    claim: ClaimSettings


@dataclass(frozen=True, eq=False)
class Inspection:
    """Comparison of the observed fold with the prediction.

    iou: overlap of prediction and observation without alignment; iou_aligned: overlap after the rigid motion that
    aligns the prediction with the observation. This motion is p -> turned(p - drift_about) + drift_about + drift.
    drift_about: (2,) centre of the predicted outline [m]. drift: (2,) displacement of this centre [m]; drift_m:
    its length; drift_rad: the angle of the motion. height_m: height of the stack above the table, away from the
    plan's fold lines (95th percentile; NaN if too little is visible). extra_height_m: the same for the height
    above the prediction. piled_area_m2: area that is too high. edge_deviation_m: largest boundary deviation after
    alignment, positive outside, at edge_place (2,). missing_layer: largest missing share (0..1) of the predicted
    height at a target, NaN if unknown. edge: the edge that two arms moved onto other cloth, None if it is not
    visible. left_behind: for each grasp, and for 'middle' between two, how much further than predicted the garment
    reaches beyond the fold line [m]; NaN if unknown. diagnosis: None when the fold is as predicted. confidence: of
    the diagnosis, 0..1. contour: (n, 2) observed boundary [m]. mask, predicted: (H, W) observed and predicted
    silhouette, and height: (H, W) above the table [m], NaN where unknown, all in `view`'s pixels.
    """

    iou: float
    iou_aligned: float
    drift: Array
    drift_about: Array
    drift_m: float
    drift_rad: float
    height_m: float
    extra_height_m: float
    piled_area_m2: float
    edge_deviation_m: float
    edge_place: Array
    missing_layer: float
    edge: MovedEdge | None
    left_behind: Mapping[str, float]
    diagnosis: FailureKind | None
    confidence: float
    contour: Array
    mask: NDArray[np.bool_]
    predicted: NDArray[np.bool_]
    height: NDArray[np.float32]
    view: TableView
    rgb: NDArray[np.uint8]
    target: TargetView | None = None
    """Comparison with the plan's target; None if no target was given."""

    @property
    def accepted(self) -> bool:
        return self.diagnosis is None
