"""The executive's knowledge during a run: one frozen value, replaced by each effect.

This knowledge comes only from the ports, the cell's files and the skills. Each stage adds its own value
(cell/states/stages.py). Values that belong to one fold are in the fold context, which is replaced for each fold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import ParamSpec, TypeVar

from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.situation import SEEING_FAILURES
from foldcell.cell.states.stages import Attempt, EstimateNote, FirstLook, FoldNote, Plan, Recognition
from foldcell.cell.states.transition_table import Event, State
from foldcell.robots.errors import Failure
from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.inspection.claim import Claim
from foldcell.skills.vocabulary import CameraCalibration, FoldStep, Outcome

T = TypeVar("T")
P = ParamSpec("P")

_MOVES_NOTHING = (
    f"-> {Event.CARRY_ON.value}",
    *(
        f"{k.value} -> {e.value}"
        for k in SEEING_FAILURES
        for e in (Event.LOOK_AGAIN, Event.LOOK_AFTER, Event.START_OVER)
    ),
)
"""Ends of the notes of recoveries that only go on or look."""


@dataclass(frozen=True, eq=False)
class Sight:
    """The camera's pictures so far.

    reference: the empty table. refined: the calibration refined from that picture, if it showed the table well
    enough. frame: the latest picture; previous: the picture before it, to detect a frozen camera, which repeats
    its picture. digests: of all still pictures of the run, to recognise an old picture with a new stamp.
    refused: a picture that was taken after `frame`, and refused.
    """

    reference: CameraFrame | None = None
    refined: CameraCalibration | None = None
    frame: CameraFrame | None = None
    previous: CameraFrame | None = None
    digests: tuple[str, ...] = ()
    refused: CameraFrame | None = None

    @property
    def shown(self) -> CameraFrame | None:
        """The latest picture for a person, whether it was refused or not."""
        return self.refused or self.frame

    def calibration(self, nominal: CameraCalibration) -> CameraCalibration:
        """Return the refined calibration if there is one, else the nominal calibration."""
        return self.refined or nominal


@dataclass(frozen=True, eq=False)
class RunContext:
    """The executive's knowledge during a run."""

    sight: Sight = field(default_factory=Sight)
    recognition: Recognition | None = None
    first_look: FirstLook | None = None
    """What the first look at the garment showed, since it was laid."""
    disturbed: bool = False
    """Whether somebody has moved the garment since it was last recognised."""
    plan: Plan | None = None
    fold: FoldContext = field(default_factory=FoldContext)
    failure: Failure | None = None
    cause: Failure | None = None
    """The failure after which the cell lays back and clears. The recovery is chosen for this failure. A failure of
    laying back or clearing does not replace it."""
    attempts: Mapping[tuple[int, str], int] = field(default_factory=dict)
    """Number of failures of a kind in a step: (step index, kind) -> count."""
    recoveries: tuple[tuple[int, str], ...] = ()
    """Every recovery so far: (step index, "failure kind -> event")."""
    forgiven: int = 0
    """Number of these recoveries before the operator's last RETRY. They no longer count against the limits."""
    estimates: tuple[EstimateNote, ...] = ()
    """The estimates of the garment's state after failures."""
    repairs: tuple[tuple[int, str], ...] = ()
    """The repairs and pulls that the hands have carried out: (step index, what it was, in words)."""
    done: tuple[FoldNote, ...] = ()
    """The completed folds."""
    layer_thickness: float | None = None
    """Thickness of a layer between the pads, as an accepted fold has shown it [m]; None before the first one."""
    through: bool = False
    """Whether the run reached the end of the plan but folds were skipped. Such a run cannot be resumed."""
    waited_s: float = 0.0
    """Cell time spent waiting for an operator [s]."""
    reentry: Event | None = None
    """The event with which this run resumed an interrupted run, else None."""
    asking: str = ""
    """Why the cell asks the operator and does not go on by itself; empty before the first question."""
    setting: str = ""
    """File, key and value of the setting that decided the failure about which the cell asks, or with which it
    gives up; empty if there is none."""

    @property
    def steps(self) -> tuple[FoldStep, ...]:
        """The planned folds; empty before the garment was recognised."""
        return self.plan.steps if self.plan else ()

    @property
    def retries(self) -> tuple[int, ...]:
        """The step index of every recovery that moved something again, since the operator's last RETRY. To carry
        on with a fold or to look again moves nothing."""
        return tuple(
            index for index, what in self.recoveries[self.forgiven :] if not what.endswith(_MOVES_NOTHING)
        )

    @property
    def recoveries_in_step(self) -> int:
        """Number of retries in the present step."""
        return self.retries.count(self.fold.index)

    def notes(self) -> dict[str, FoldNote]:
        """Return fold name -> note for the completed folds and the present fold. Skipped folds have no note."""
        notes, present = {note.name: note for note in self.done}, self.fold.note()
        return notes if present is None or present.name in notes else {**notes, present.name: present}

    def claim(self) -> Claim | None:
        """Return the claim about the last fold, or None before the last fold was inspected."""
        note = self.notes().get(self.steps[-1].name) if self.steps else None
        return note.attempt.claim if note else None

    def with_attempt(self, attempt: Attempt) -> RunContext:
        return replace(self, fold=replace(self.fold, attempt=attempt))

    def counted_anew(self) -> RunContext:
        """Return the context with the failures of the present fold forgotten."""
        others = {key: count for key, count in self.attempts.items() if key[0] != self.fold.index}
        return replace(self, attempts=others)

    def with_failure(self, failure: Failure) -> RunContext:
        """Return the context with this failure, which is also counted in `attempts`."""
        key = (self.fold.index, failure.kind.value)
        return replace(self, failure=failure, attempts={**self.attempts, key: self.attempts.get(key, 0) + 1})

    def failed(self, failure: Failure, record: Mapping[str, object] | None = None) -> Result:
        """Return the result of an effect that ends with this failure. record: figures for the journal."""
        return Result(Event.FAILED, self.with_failure(failure), record or {})

    @property
    def measured_layer(self) -> float | None:
        """Thickness of a layer between the pads, as measured last [m]."""
        return self.fold.layer_thickness or self.layer_thickness

    def need(self, outcome: Outcome[T], record: Mapping[str, object] | None = None) -> T:
        """Return the outcome's value. If it is a failure, the effect ends with it (`effect`)."""
        self.require(outcome.failure, record)
        return outcome.unwrap()

    def require(self, failure: Failure | None, record: Mapping[str, object] | None = None) -> None:
        """End the effect with the failure (`effect`), if there is one."""
        if failure is not None:
            raise EffectFailed(self.failed(failure, record))


@dataclass(frozen=True, eq=False)
class Result:
    """How an effect ended: the event for the machine, the new context, and figures for the journal."""

    event: Event
    context: RunContext
    record: Mapping[str, object] = field(default_factory=dict)
    within: tuple[tuple[float, str], ...] = ()
    """Events that happened during the effect: (cell time [s], name). They are already in the journal."""


@dataclass(frozen=True, eq=False)
class RunEnd:
    """Terminal state and last context of a run. started, ended: cell time [s]. stage_times: cell time spent in
    each state [s]."""

    state: State
    context: RunContext
    started: float
    ended: float
    stage_times: Mapping[str, float]


class EffectFailed(Exception):
    """Ends an effect with a failure. result: of the effect."""

    def __init__(self, result: Result) -> None:
        super().__init__(str(result.context.failure))
        self.result = result


def effect(perform: Callable[P, Result]) -> Callable[P, Result]:
    """Make an effect of a function that uses `RunContext.need` and `RunContext.require`."""

    @wraps(perform)
    def performed(*args: P.args, **kwargs: P.kwargs) -> Result:
        try:
            return perform(*args, **kwargs)
        except EffectFailed as failed:
            return failed.result

    return performed
