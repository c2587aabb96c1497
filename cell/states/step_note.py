"""The record of one fold, for the report."""

from __future__ import annotations

from dataclasses import dataclass

from robots.ports import Array, CameraFrame
from skills.perception.inspection.claim import Claim
from skills.perception.inspection.inspect import Inspection
from skills.vocabulary import GraspTrajectory, PredictedShape

__all__ = ["StepNote"]


@dataclass(frozen=True, eq=False)
class StepNote:
    """The record of one fold. Contours are (k, 2) and meshes (n, 3), in the table frame [m]. Values of a missing
    inspection are NaN or empty."""

    name: str
    accepted: bool
    """Whether the inspection found nothing wrong, and the claim holds if one was made."""
    source: str
    dissimilarity_m: float
    aligned_iou: float
    """IoU of the observed shape with the prediction after a rigid alignment of the two."""
    observed_iou: float
    """IoU of the observed shape with the prediction, without alignment."""
    drift_m: float
    height_m: float
    """Observed height of the stack away from the fold lines [m] (NaN: not visible)."""
    grasps: int
    """Number of times that the hands approached the grasps of this fold."""
    pressed: tuple[Inspection, ...]
    """The inspection before each pressing."""
    inspected: Inspection | None
    """The last inspection."""
    predicted: PredictedShape
    observed: Array
    trajectory: GraspTrajectory
    plan_frames: Array
    pictures: tuple[CameraFrame, ...]
    claim: Claim | None = None
    """The claim about the last fold, else None."""
    carrying_s: float = float("nan")
    """Duration of the arms' last motion with the garment, from the lift to the release, without pauses [s] (NaN:
    none was planned)."""
