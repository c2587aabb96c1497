"""The result of an inspection, and its thresholds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.inspection.claim_settings import ClaimSettings
from skills.perception.inspection.moved_edge import MovedEdge
from skills.perception.inspection.target_view import TargetView
from skills.perception.rectification.table_view import TableView
from skills.perception.settings import PerceptionSettings
from skills.vocabulary import FailureKind

__all__ = ["Inspection", "InspectionSettings"]


@dataclass(frozen=True)
class InspectionSettings:
    """Limits: a fold within all of them counts as predicted. Lengths [m], angles [rad], areas [m2]."""

    iou: float = 0.90
    """Minimum overlap with the prediction after rigid alignment."""
    drift: float = 0.030
    drift_angle: float = float(np.deg2rad(6.0))
    extra_height: float = 0.015
    piled_area: float = 0.0012
    """Maximum area that is more than `extra_height` higher than predicted."""
    fold_margin: float = 0.040
    """Nearer than this to a fold line, heights are not judged, because the crease bulges there."""
    deviation: float = 0.022
    """Maximum distance between observed and predicted boundary after alignment."""
    corner_radius: float = 0.07
    left_behind: float = 0.035
    """Limit of `Inspection.left_behind` if the outline is not as predicted. If all values are larger, a layer was
    missed. If the values at the two grasps differ by more, one corner was dropped."""
    sag: float = 0.020
    """If the garment is left behind in the middle further than at both grasps, by more than this, the cloth
    between the hands sagged."""
    strip: float = 0.06
    """Half the width of the strips in which `left_behind` and `sag` are measured: one strip at each grasp, and one
    between two grasps."""
    missing_share: float = 0.45
    """Maximum missing share of the predicted height at a target."""
    layer_height: float = 0.0018
    """Minimum predicted height at a target. If it is lower, missing layers are not judged there, because depth
    cannot resolve so little."""
    edge_sag: float = 0.026
    edge_corner: float = 0.0195
    """Limits for an edge that was moved onto other cloth (`moved_edge`): `edge_sag` for the lag of its middle,
    `edge_corner` for the lag of a corner.

    The lag of a corner is measured in steps of 2 mm, or of 1 mm if a strip is not visible; the limit lies between
    two steps. A corner that is 40 mm behind is measured as 20 to 40 mm. In still pictures, good folds lag by up to
    15 mm, nearly all by less than 8 mm."""
    edge_rise: float = 0.0022
    edge_lag_thin: float = 0.030
    """For layers that raise the surface by less than `edge_rise`, the two limits grow in inverse proportion to the
    rise, and for an edge that is too short for wide strips with the noise of its strips, up to `edge_lag_thin`:
    wrinkles of a millimetre then hide the edge."""
    perception: PerceptionSettings = field(default_factory=PerceptionSettings)
    claim: ClaimSettings = field(default_factory=ClaimSettings)


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
