"""What the executive believes during a run: one frozen value, replaced by each effect.

Nothing in it comes from anywhere but the ports, the files of the cell, and the skills. What a stage came to is a
value of its own (cell/states/stages.py), there once the stage was gone through; what belongs to one fold is in its
fold context, which is made anew for each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from cell.states.fold_context import FoldContext
from cell.states.stages import Attempt, Plan, Recognition
from cell.states.step_note import StepNote
from cell.states.transition_table import Event
from robots.errors import Failure
from robots.ports import CameraFrame
from skills.vocabulary import CameraCalibration, FoldStep

__all__ = ["Result", "RunContext", "Sight"]


@dataclass(frozen=True, eq=False)
class Sight:
    """What the camera has given so far.

    reference: the empty table. refined: the camera's pose corrected by that picture, where it showed the table
    well enough. frame: the latest picture; previous: the one before (a camera that repeats itself is frozen).
    """

    reference: CameraFrame | None = None
    refined: CameraCalibration | None = None
    frame: CameraFrame | None = None
    previous: CameraFrame | None = None

    def calibration(self, nominal: CameraCalibration) -> CameraCalibration:
        """The refined calibration where there is one."""
        return self.refined or nominal


@dataclass(frozen=True, eq=False)
class RunContext:
    """The run's knowledge."""

    sight: Sight = field(default_factory=Sight)
    recognition: Recognition | None = None
    plan: Plan | None = None
    fold: FoldContext = field(default_factory=FoldContext)
    failure: Failure | None = None
    attempts: Mapping[tuple[int, str], int] = field(default_factory=dict)
    """How often a failure kind was met in a step: (step index, kind) -> count."""
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
    def steps(self) -> tuple[FoldStep, ...]:
        """The folds as far as they are planned: none before the garment was recognised."""
        return self.plan.steps if self.plan else ()

    @property
    def recoveries_in_step(self) -> int:
        return sum(1 for index, _ in self.recoveries if index == self.fold.index)

    def notes(self) -> dict[str, StepNote]:
        """By name, the folds that count as made, and the one at which the run stands. A fold that was skipped has
        none."""
        notes, now = {note.name: note for note in self.done}, self.fold.note()
        return notes if now is None or now.name in notes else {**notes, now.name: now}

    def with_attempt(self, attempt: Attempt) -> RunContext:
        return replace(self, fold=replace(self.fold, attempt=attempt))

    def with_failure(self, failure: Failure) -> RunContext:
        """The failure noted and counted."""
        key = (self.fold.index, failure.kind.value)
        return replace(self, failure=failure, attempts={**self.attempts, key: self.attempts.get(key, 0) + 1})


@dataclass(frozen=True, eq=False)
class Result:
    """How an effect ended: the event for the machine, the new belief, and figures for the record."""

    event: Event
    context: RunContext
    record: Mapping[str, object] = field(default_factory=dict)
    within: tuple[tuple[float, str], ...] = ()
    """What the runner was told of on the way, in the journal by then: (cell time [s], name)."""
