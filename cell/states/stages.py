"""What the stages of a run come to, each a value that the next ones take: recognition, plan, attempt, pressing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, CameraFrame, Side
from skills.cloth.mesh import ClothMesh
from skills.garments.garment import Garment
from skills.motion.moves.fold import FoldMotion
from skills.perception.inspection.inspect import Inspection
from skills.perception.perceive import Perception
from skills.vocabulary import FoldStep, GarmentState, Grasp, GraspId, GraspTrajectory, PredictedShape, ToolPath

__all__ = ["Attempt", "Plan", "PressPlan", "Recognition"]


@dataclass(frozen=True, eq=False)
class Recognition:
    """The garment as it was recognised lying flat. overlay: (h, w, 3) the picture with it drawn over."""

    perception: Perception
    overlay: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Plan:
    """The folds of the garment, and where it is believed to lie before the fold at hand.

    nominal: the garment as its file describes it; garment: with the material that earlier folds have shown it to
    have. flat: the garment as it lay flat, where it would lie so now: what the rest of the plan is made from.
    mesh: the predictor's own, from the perceived contour; vertices: (n, 3) where they lie, in the table frame [m].
    """

    nominal: Garment
    garment: Garment
    flat: GarmentState
    steps: tuple[FoldStep, ...]
    mesh: ClothMesh
    vertices: Array


@dataclass(frozen=True, eq=False)
class PressPlan:
    """How a fold is to be pressed: what was seen of it, the hands' paths and the arms' motion."""

    seen: Inspection
    paths: Mapping[GraspId, ToolPath]
    motion: FoldMotion
    dabs: int


@dataclass(frozen=True, eq=False)
class Attempt:
    """One try at a fold: as it was planned, and what has come of it so far.

    step: as this try makes it (recoveries move its grasps), paths: its tool paths; tool_speed: cap of the tools'
    speed while they hold the garment [m/s]. predicted: the garment after it, with the tool paths that the arms
    execute; dissimilarity_m: D of that from the ideal fold. plan_frames: (k, n, 3) the predicted motion at evenly
    spaced moments, for the report.
    """

    trajectory: GraspTrajectory
    step: FoldStep
    paths: Mapping[GraspId, ToolPath]
    tool_speed: float
    motion: FoldMotion
    predicted: PredictedShape
    dissimilarity_m: float
    plan_frames: Array
    before: CameraFrame | None = None
    """The picture before it: against it shows what the fold laid on top."""
    pictures: tuple[CameraFrame, ...] = ()
    """What the camera saw at the moments of plan_frames."""
    carried: bool = False
    """Whether the garment was carried through, and nobody has judged yet what came of it."""
    inspection: Inspection | None = None
    pressed: tuple[Inspection, ...] = ()
    """How the camera saw it each time before it was pressed."""
    press_tries: int = 0
    """How often that was tried."""
    press_plan: PressPlan | None = None
    unpressed: bool = False
    """Whether the operator wants it left as it is."""

    def grasp_of(self, arm: Side) -> Grasp:
        """The grasp that an arm takes: the motion planner may have swapped them."""
        return self.step.grasps[self.motion.postures[arm].path]
