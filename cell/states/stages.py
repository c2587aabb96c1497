"""The results of a run's stages, which the next stages take as input: recognition, plan, attempt, press plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, CameraFrame, Side, frozen
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.plan import rigid_motion, translate_plan
from foldcell.skills.fold_plan.repair import RepairGoal, RepairPlan
from foldcell.skills.garments.garment import Garment
from foldcell.skills.motion.moves.fold import FoldMotion
from foldcell.skills.perception.inspection.claim import Claim
from foldcell.skills.perception.inspection.height_expectation import CameraBias
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.perception.perceive import Perception
from foldcell.skills.state_estimate.comparison import Fit
from foldcell.skills.vocabulary import (
    FoldStep,
    GarmentState,
    Grasp,
    GraspId,
    GraspTrajectory,
    PredictedShape,
    ToolPath,
)


@dataclass(frozen=True, eq=False)
class FirstLook:
    """What the first look at the flat garment showed. contour: (n, 2) its outline [m]; bias: of the camera's
    heights."""

    contour: Array
    bias: CameraBias


@dataclass(frozen=True, eq=False)
class Recognition:
    """The recognised garment, lying flat. overlay: (h, w, 3) the picture with the recognised garment drawn on
    it."""

    perception: Perception
    overlay: NDArray[np.uint8]

    def in_words(self) -> str:
        """Return what was recognised, and how sure that is."""
        perception = self.perception
        return f"{perception.garment.replace('_', ' ')}, confidence {perception.state.confidence:.2f} of 1"


@dataclass(frozen=True, eq=False)
class Plan:
    """The folds of the garment, and its believed shape before the present fold.

    nominal: the garment as its file describes it; garment: with the material learned from earlier folds. flat: the
    garment when it lay flat, moved by the drift observed since then; the remaining folds are planned from it.
    mesh: the predictor's mesh of the observed contour; vertices: (n, 3) believed positions in the table frame [m].
    """

    nominal: Garment
    garment: Garment
    flat: GarmentState
    steps: tuple[FoldStep, ...]
    mesh: ClothMesh
    vertices: Array

    def drifted(self, seen: Inspection) -> Plan:
        """Return the plan after a drift: its flat garment, fold steps, believed shape and material coordinates are
        moved by the observed drift."""
        return replace(
            self,
            flat=replace(
                self.flat,
                contour=with_drift(self.flat.contour, seen),
                keypoints={name: with_drift(point, seen) for name, point in self.flat.keypoints.items()},
            ),
            steps=translate_plan(self.steps, seen.drift, seen.drift_rad, seen.drift_about),
            mesh=replace(self.mesh, rest=with_drift(self.mesh.rest, seen)),
            vertices=frozen(np.column_stack([with_drift(self.vertices[:, :2], seen), self.vertices[:, 2]])),
        )


def with_drift(points: Array, seen: Inspection) -> Array:
    """Return points (..., 2) [m], moved by the observed drift."""
    return frozen(rigid_motion(points, seen.drift, seen.drift_rad, seen.drift_about))


@dataclass(frozen=True, eq=False)
class PressPlan:
    """The plan for pressing a fold. inspection: the inspection before the pressing; paths: the hands' tool paths;
    motion: the arms' motion; dabs: number of dabs."""

    inspection: Inspection
    paths: Mapping[GraspId, ToolPath]
    motion: FoldMotion
    dabs: int


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt at a fold: its plan and its outcome so far.

    step: the fold step, after recoveries have moved its grasps; paths: its tool paths; tool_speed: largest tool
    speed with the garment in hand [m/s]. predicted: the garment's shape after the motion that the arms execute;
    dissimilarity_m: D of that shape from the ideal fold. plan_frames: (k, n, 3) predicted vertices at evenly
    spaced moments of the motion, in the table frame [m], for the report.
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
    """The picture before the fold. Its comparison with the picture after the fold shows the cloth that the fold
    laid on top."""
    pictures: tuple[CameraFrame, ...] = ()
    """Pictures at evenly spaced moments of the fold."""
    carried: bool = False
    """Whether the hands completed the fold."""
    inspection: Inspection | None = None
    claim: Claim | None = None
    """The claim that the garment is folded, made by the inspection of the last fold."""
    pressed: tuple[Inspection, ...] = ()
    """The inspection before each pressing."""
    press_tries: int = 0
    """Number of attempts to press."""
    press_plan: PressPlan | None = None
    unpressed: bool = False
    """Whether the operator skipped the pressing."""
    repaired: bool = False
    """Whether a repair has completed the fold, so that its own motion does not explain how the garment lies."""
    repair_s: float | None = None
    """Duration of the motion of that repair, from the lift to the release [s]."""
    interrupted: bool = False
    """Whether the hands came to the target otherwise than planned: they stopped on the way, or took cloth along
    when they left."""

    @property
    def disturbed(self) -> bool:
        """Whether layers of the fold may lie elsewhere than planned under those that the camera sees."""
        return self.repaired or self.interrupted

    @property
    def carrying_s(self) -> float:
        """Duration of the motion that carried the garment, from the lift to the release [s]. If a repair has
        completed the fold, it is the motion of the repair."""
        return self.motion.fold.duration if self.repair_s is None else self.repair_s

    def grasp_of(self, arm: Side) -> Grasp:
        """The grasp that this arm makes. The motion planner may have swapped the grasps between the arms."""
        return self.step.grasps[self.motion.postures[arm].path]


@dataclass(frozen=True, eq=False)
class FoldNote:
    """A fold that was planned, in the state that it has reached. grasps: number of times that the hands approached
    its grasps. anew: what was seen of the fold when the garment had been disturbed since its inspection. hidden:
    whether it was disturbed, and later folds hide it, so that what was seen of the fold is not known any more."""

    attempt: Attempt
    grasps: int
    anew: Inspection | None = None
    hidden: bool = False

    @property
    def name(self) -> str:
        return self.attempt.step.name

    @property
    def inspected(self) -> Inspection | None:
        """The last inspection."""
        return self.anew or self.attempt.inspection

    @property
    def accepted(self) -> bool:
        """Whether the inspection found nothing wrong, and the claim holds if one was made."""
        seen, claim = self.inspected, self.attempt.claim
        return seen is not None and seen.diagnosis is None and (claim is None or claim.holds)


@dataclass(frozen=True, eq=False)
class EstimateNote:
    """An estimate of the garment's state. fold: index of the fold; t: cell time [s]; says: the state in words;
    picture: (H, W, 3) the candidates drawn over the picture."""

    fold: int
    t: float
    says: str
    picture: NDArray[np.uint8]


_DESTINATIONS = {
    RepairGoal.COMPLETE: "on to the target of the fold",
    RepairGoal.UNDO: "back where it lay before the fold",
}


@dataclass(frozen=True, eq=False)
class Repair:
    """The repair of a fold that failed. It is planned, checked and performed like a fold.

    plan: grasps where the moved cloth lies now, targets where it has to lie; trajectory: the arcs between them.
    vertices: (n, 3) believed positions now; target: (n, 3) positions to be reached [m]. Both are at the place
    where the garment was found. displaced: displacement of this place from the plan. failed: the attempt that is
    repaired.
    """

    plan: RepairPlan
    trajectory: GraspTrajectory
    vertices: Array
    target: Array
    displaced: Fit
    failed: Attempt

    @property
    def name(self) -> str:
        """What is done, in one word."""
        return self.plan.goal.value

    def in_words(self) -> str:
        """Return what the hands do."""
        return f"the hands carry the moved cloth {_DESTINATIONS[self.plan.goal]}"

    def ended(self, performed: Attempt) -> Attempt:
        """Return the failed attempt after its repair, without its earlier inspections and pressings. performed:
        the attempt at the repair. If it has completed the fold, the garment is expected as the repair was
        predicted to leave it, and is inspected as usual; the report shows the repair."""
        failed = replace(
            self.failed, carried=False, inspection=None, claim=None, pressed=(), press_tries=0, press_plan=None,
            unpressed=False,
        )  # fmt: skip
        if self.plan.goal is RepairGoal.UNDO or not performed.carried:
            return failed
        # relative to the plan, which moves only when an inspection has measured the displacement
        vertices = self.displaced.taken_back(performed.predicted.vertices)
        return replace(
            failed, predicted=replace(performed.predicted, vertices=vertices),
            dissimilarity_m=performed.dissimilarity_m, plan_frames=performed.plan_frames,
            pictures=performed.pictures, carried=True, repaired=True, repair_s=performed.carrying_s,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Spread:
    """A pull that spreads a garment of which only the silhouette is known. It is planned, checked and performed
    like a fold, but not simulated.

    step: the pull as a fold step; trajectory: its arcs. contour: (n, 2) silhouette now [m]. aim: (n, 3) vertices
    of the plan's mesh, flat where the garment would lie if it were spread [m]. covered_m2: area of the silhouette.
    home: whether the garment lies spread, and is drawn back to where it was laid.
    """

    step: FoldStep
    trajectory: GraspTrajectory
    contour: Array
    aim: Array
    covered_m2: float
    home: bool = False

    @property
    def name(self) -> str:
        """What is done, in one word."""
        return "spread"

    def in_words(self) -> str:
        """Return what the hands do."""
        hands = "both hands pull" if len(self.step.grasps) == 2 else "a hand pulls"
        if self.home:
            return f"{hands} the flat garment back to where it was laid"
        what = "corners of the heap apart" if len(self.step.grasps) == 2 else "a corner of the heap outwards"
        return f"{hands} {what}, low over the table, to spread it"
