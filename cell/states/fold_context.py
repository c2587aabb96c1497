"""The state of the present fold. Each fold begins with a new context, which keeps nothing of the previous fold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.stages import Attempt, FoldNote, Plan, Repair, Spread
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import ArmTrajectory, Side
from foldcell.skills.fold_plan.repair import RepairGoal
from foldcell.skills.grasping.confirm import Held
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.motion.kinematics.posture import Posture
from foldcell.skills.motion.moves.fold import FoldMotion
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.vocabulary import GraspTrajectory


@dataclass(frozen=True, eq=False)
class FoldContext:
    """The present fold. index: index of its step; trajectory: the chosen arcs; attempt: the latest planned
    attempt."""

    index: int = 0
    trajectory: GraspTrajectory | None = None
    attempt: Attempt | None = None
    grasps: int = 0
    """Number of times that the hands approached the grasps of this fold."""
    adjustments: tuple[Adjustment, ...] = ()
    """Adjustments that recoveries have made, in order."""
    edits: tuple[PlanEdit, ...] = ()
    """Changes that the operator has made to the plan of this fold, in order."""
    refused_edit: str = ""
    """Why the last edits could not be made; empty if they could."""
    avoided: tuple[Mapping[Side, Posture], ...] = ()
    """Hand postures of earlier attempts. The search after the recovery OTHER_SEARCH excludes these postures."""
    biases: Mapping[Side, TactileBias] = field(default_factory=dict)
    """For each hand in use: its tactile bias, measured above the garment."""
    table_contact: Mapping[Side, float] = field(default_factory=dict)
    """Height at which each hand felt the table through the cloth in its last grasp of a whole stack, minus the
    deflection of arm and fingertips [m]. It shows the error of the hand's height."""
    touched: bool = False
    """Whether the hands may have moved the garment since it was last found."""
    estimate: StateEstimate | None = None
    """The state of the garment after a failure of the latest attempt, with the best fit of each state."""
    repair: Repair | Spread | None = None
    """The repair in progress, or the pull that spreads the garment. `attempt` is then the attempt at it."""
    tried: tuple[RepairGoal, ...] = ()
    """The goals of the repairs of this fold that were planned, in order."""
    refused: tuple[tuple[FailureKind, FoldMotion], ...] = ()
    """The failures after which a repair was chosen, each with the motion that had made the fold."""
    pulls: int = 0
    """Number of pulls to spread the garment that were planned."""
    covered: tuple[float, ...] = ()
    """Area that the garment covered before each of these pulls that was carried out [m2]."""
    spread: bool = True
    """Whether another pull may spread the garment. False when no pull can be planned or the last one did not
    help."""
    held: Mapping[Side, Held] = field(default_factory=dict)
    """Confirmed grasp of each hand that holds the garment."""
    carrying: tuple[ArmTrajectory, ...] = ()
    """The checked trajectories on which the hands carried the cloth in this attempt: the lift, then the arc. The
    hands may have stopped on the way of the last trajectory."""
    layer_thickness: float | None = None
    """Thickness of a layer between the pads, if the hands hold the planned layers [m]."""

    @property
    def arcs(self) -> GraspTrajectory | None:
        """The arcs of the next motion: the arcs of the repair or pull in progress, else of the fold."""
        return self.trajectory if self.repair is None else self.repair.trajectory

    def planned_layer(self, plan: Plan) -> float:
        """Return the thickness of a layer from which the heights of the next grasps follow [m]."""
        return self.repair.plan.thickness if isinstance(self.repair, Repair) else plan.garment.material.thickness

    @property
    def carried(self) -> bool:
        """Whether the hands completed the fold (`Attempt.carried`)."""
        return self.attempt is not None and self.attempt.carried

    @property
    def uncertain(self) -> bool:
        """Whether the garment may lie in any state of the fold: it was touched, and the fold was not completed."""
        return self.touched and self.attempt is not None and not self.carried

    def after_repair(self) -> FoldContext:
        """Return the context after a repair, whether it succeeded or not. Unless the repair has completed the
        fold, the position of the garment is then unknown. After a pull the fold begins anew, without what was
        planned for it."""
        if isinstance(self.repair, Spread):
            covered = (*self.covered, self.repair.covered_m2) if self.carried else self.covered
            return replace(self, repair=None, attempt=None, covered=covered, touched=True, estimate=None)
        if self.repair is None or self.attempt is None:
            return self
        return replace(self, repair=None, attempt=self.repair.ended(self.attempt), touched=True, estimate=None)

    def failed_alike(self, kind: FailureKind) -> bool:
        """Whether the fold was made anew after a repair, and has now failed as before it."""
        motion = None if self.attempt is None else self.attempt.motion
        return any(_sort(kind) is _sort(before) and motion is not made for before, made in self.refused)

    def count(self, adjustment: Adjustment) -> int:
        return self.adjustments.count(adjustment)

    def note(self) -> FoldNote | None:
        """Return the fold as it is now, for the record. None before the fold was planned, and while the garment is
        pulled."""
        if isinstance(self.repair, Spread):
            return None
        attempt = self.repair.failed if self.repair else self.attempt
        return None if attempt is None else FoldNote(attempt, self.grasps)


def _sort(kind: FailureKind) -> FailureKind:
    """Return one kind for both that stand for too much height."""
    return FailureKind.PILING if kind is FailureKind.TOO_HIGH else kind
