"""A fold as it was made, for the report."""

from __future__ import annotations

from dataclasses import dataclass

from robots.ports import Array, CameraFrame
from skills.perception.inspection.inspect import Inspection
from skills.vocabulary import GraspTrajectory, PredictedShape

__all__ = ["StepNote"]


@dataclass(frozen=True, eq=False)
class StepNote:
    """One fold as it was made, for the report. Shapes (k, 2) contours and (n, 3) meshes in the table frame. What
    nobody looked at is NaN or empty: a fold that failed on its way."""

    name: str
    accepted: bool
    """Whether the inspection found nothing wrong."""
    source: str
    dissimilarity_m: float
    aligned_iou: float
    """Of what was seen with the prediction, once that is laid on it as well as it goes,"""
    observed_iou: float
    """and where the prediction lies."""
    drift_m: float
    height_m: float
    """How high the camera saw the stack stand, away from the fold lines (NaN: not seen)."""
    grasps: int
    pressed: tuple[Inspection, ...]
    """How it was seen to stand each time before it was pressed,"""
    inspected: Inspection | None
    """and at last."""
    predicted: PredictedShape
    observed: Array
    trajectory: GraspTrajectory
    plan_frames: Array
    pictures: tuple[CameraFrame, ...]
    carrying_s: float = float("nan")
    """How long the arms' last motion with the garment takes, from the lifted grasps to the release, pauses left
    out [s] (NaN: none was planned)."""
