"""What an inspection says, and the thresholds that it says it by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.inspection.moved_edge import MovedEdge
from skills.perception.perceive import PerceptionSettings
from skills.perception.rectification.table_view import TableView
from skills.vocabulary import FailureKind

__all__ = ["Inspection", "InspectionSettings"]


@dataclass(frozen=True)
class InspectionSettings:
    """When a fold is as predicted. Lengths [m], angles [rad], areas [m2]."""

    iou: float = 0.90
    """Overlap with the prediction, after rigid alignment."""
    drift: float = 0.030
    drift_angle: float = float(np.deg2rad(6.0))
    extra_height: float = 0.015
    piled_area: float = 0.0012
    """Area that may stand higher than predicted by `extra_height` before it is piled up."""
    fold_margin: float = 0.040
    """Heights nearer than this to a fold line are not judged: the fold's bulge is there."""
    deviation: float = 0.022
    """Boundary deviation that counts as a defect of the edge."""
    corner_radius: float = 0.07
    left_behind: float = 0.035
    """A corner that lies further behind than the other by this was dropped."""
    sag: float = 0.020
    """The middle of the fold that lies further behind than both ends by this sagged."""
    strip: float = 0.06
    """Half width of the strips, beside each grasp and between them, in which that is looked for."""
    missing_share: float = 0.45
    """A target that lacks this share of its upper layer's predicted height did not get it."""
    layer_height: float = 0.0018
    """Upper layers predicted thinner than this cannot be seen by depth."""
    edge_sag: float = 0.026
    edge_corner: float = 0.0195
    """How far the moved edge's middle, and a corner of it, may lie behind the rest, on cloth (`moved_edge`). A
    corner is seen as the mean over its strip, in steps of 2 mm, of 1 mm where a strip is not seen (the limit lies
    on no step): 20 to 40 mm behind where it lies 40 mm behind. In still pictures good folds lie behind by up to
    15 mm, nearly all by less than 8."""
    perception: PerceptionSettings = field(default_factory=PerceptionSettings)


@dataclass(frozen=True, eq=False)
class Inspection:
    """Observed against predicted.

    iou: as seen; iou_aligned: after the rigid motion that lays the prediction on what is seen. drift: (2,)
    [m] how that motion moves drift_about (2,), the middle of the prediction's outline; drift_m its length,
    drift_rad its angle: p -> turned(p - drift_about) + drift_about + drift.
    height_m: how high the stack stands above the table, away from the plan's fold lines (95th percentile; NaN
    where too little is seen). extra_height_m: likewise above the prediction, where both are.
    piled_area_m2: area that stands too high. edge_deviation_m: largest boundary deviation after alignment,
    outside positive, at edge_place (2,). missing_layer: largest share of a target's upper layers that is
    not there (0..1), NaN when nobody can see it. edge: where the edge that two arms moved came to lie on other
    cloth, None when nobody can see it. left_behind: for each grasp, and for the
    middle between two ('middle'), how much further than predicted the garment still reaches beyond the fold
    line there [m]; NaN where it is not seen. diagnosis: None when the fold is as predicted.
    contour: (n, 2) observed boundary. mask, predicted, and height above the table [m], NaN where nothing was seen:
    (H, W) in `view`'s pixels.
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

    @property
    def accepted(self) -> bool:
        return self.diagnosis is None
