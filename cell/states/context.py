"""What the executive believes during a run: one frozen value, replaced by each effect.

Nothing in it comes from anywhere but the ports, the files of the cell, and the skills.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cell.states.recovery_table import Adjustment
from cell.states.transition_table import Event
from robots.errors import Failure
from robots.ports import Array, CameraFrame, Side
from skills.cloth.mesh import ClothMesh
from skills.garments.garment import Garment
from skills.grasping.confirm import Held
from skills.grasping.tare import Zero
from skills.motion.kinematics.posture import Posture
from skills.motion.moves.fold import FoldMotion
from skills.perception.inspection.inspect import Inspection
from skills.perception.perceive import Perception
from skills.vocabulary import (
    CameraCalibration,
    FoldStep,
    GarmentState,
    Grasp,
    GraspId,
    GraspTrajectory,
    PredictedShape,
    ToolPath,
)

__all__ = ["Context", "Result", "StepNote"]


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


@dataclass(frozen=True, eq=False)
class Context:
    """The run's knowledge. Fields are filled in the order in which a run comes to know them."""

    reference: CameraFrame | None = None
    """The empty table."""
    refined: CameraCalibration | None = None
    """The camera's pose corrected by that picture: the table's plane and edges are known."""
    frame: CameraFrame | None = None
    """The latest picture."""
    previous: CameraFrame | None = None
    """The one before: a camera that repeats itself is frozen."""
    before_fold: CameraFrame | None = None
    """The picture before the fold at hand: against it shows what the fold laid on top."""
    overlay: NDArray[np.uint8] | None = None
    """The picture with what was recognised drawn over it."""
    perception: Perception | None = None
    flat: GarmentState | None = None
    """The garment as it lay flat, where it would lie so now: what the rest of the plan is made from."""
    garment: Garment | None = None
    """The garment as its file describes it: named on the command line, or recognised."""
    steps: tuple[FoldStep, ...] = ()
    index: int = 0
    """Which step is under way."""
    mesh: ClothMesh | None = None
    """The predictor's own mesh of the garment, from the perceived contour."""
    vertices: Array | None = None
    """(n, 3) where the predictor believes the garment to lie before this step."""
    trajectory: GraspTrajectory | None = None
    motion: FoldMotion | None = None
    predicted: PredictedShape | None = None
    """The garment after this step, predicted with the tool path that the arms execute."""
    dissimilarity_m: float = float("nan")
    """D of that prediction against the ideal fold."""
    grasps: int = 0
    """How often this fold was tried."""
    plan_frames: Array | None = None
    """(k, n, 3) the predicted motion at evenly spaced moments, for the report."""
    pictures: tuple[CameraFrame, ...] = ()
    """What the camera saw at those moments."""
    planned_step: FoldStep | None = None
    """The step as this try makes it (grasps moved by recoveries), and its tool paths by grasp."""
    planned_paths: Mapping[GraspId, ToolPath] = field(default_factory=dict)
    avoided: tuple[Mapping[Side, Posture], ...] = ()
    """Hand postures that this step has already tried: another search leaves them out."""
    tool_speed: float = 0.3
    """Cap of the tools' speed while they hold the garment [m/s]."""
    zeros: Mapping[Side, Zero] = field(default_factory=dict)
    """The tactile cells' zero of each hand in use, taken above the garment."""
    held: Mapping[Side, Held] = field(default_factory=dict)
    """What each hand was confirmed to hold."""
    carried: bool = False
    """Whether the garment was carried through the fold at hand, and nobody has judged yet what came of it."""
    pressed: tuple[Inspection, ...] = ()
    """How the camera saw this fold each time before it was pressed."""
    press_tries: int = 0
    """How often that was tried."""
    press_paths: Mapping[GraspId, ToolPath] = field(default_factory=dict)
    press_motion: FoldMotion | None = None
    """How it is to be pressed: the hands' paths and the arms' motion."""
    unpressed: bool = False
    """Whether the operator wants this fold left as it is."""
    inspection: Inspection | None = None
    failure: Failure | None = None
    attempts: Mapping[tuple[int, str], int] = field(default_factory=dict)
    """How often a failure kind was met in a step: (step index, kind) -> count."""
    adjustments: tuple[Adjustment, ...] = ()
    """What recoveries changed for the present step, in order."""
    recoveries: tuple[tuple[int, str], ...] = ()
    """Every recovery so far: (step index, failure -> what was tried)."""
    done: tuple[StepNote, ...] = ()
    """The folds that count as made."""
    through: bool = False
    """Whether the plan is at its end: a fold that was left out is not made any more."""
    waited_s: float = 0.0
    """Cell time spent waiting for an operator."""
    reentry: Event | None = None
    """Where this run was entered, if it goes on with an interrupted one."""

    @property
    def step(self) -> FoldStep:
        return self.steps[self.index]

    def calibration(self, nominal: CameraCalibration) -> CameraCalibration:
        """The refined calibration where there is one."""
        return self.refined or nominal

    @property
    def known_garment(self) -> Garment:
        assert self.garment is not None
        return self.garment

    def grasp_of(self, arm: Side) -> Grasp:
        """The grasp that an arm takes in this try: the motion planner may have swapped them."""
        assert self.motion is not None and self.planned_step is not None
        return self.planned_step.grasps[self.motion.postures[arm].path]

    @property
    def recoveries_in_step(self) -> int:
        return sum(1 for index, _ in self.recoveries if index == self.index)

    def count(self, adjustment: Adjustment) -> int:
        return self.adjustments.count(adjustment)

    def with_failure(self, failure: Failure) -> Context:
        """The failure noted and counted."""
        key = (self.index, failure.kind.value)
        return replace(self, failure=failure, attempts={**self.attempts, key: self.attempts.get(key, 0) + 1})


@dataclass(frozen=True, eq=False)
class Result:
    """How an effect ended: the event for the machine, the new belief, and figures for the record."""

    event: Event
    context: Context
    record: Mapping[str, object] = field(default_factory=dict)
    within: tuple[tuple[float, str], ...] = ()
    """What the runner was told of on the way, in the ledger by then: (cell time [s], name)."""
