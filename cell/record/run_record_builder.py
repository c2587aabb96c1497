"""An observer of the runner that makes the record of the run."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from foldcell.cell.config.deciding_setting import deciding_setting
from foldcell.cell.record.run_record import (
    NOTHING_LOST,
    FailureRecord,
    FoldRecord,
    GraspRecord,
    Recognised,
    RecordingLosses,
    RunEvent,
    RunRecord,
    RunResult,
    ScoreRecord,
    known,
)
from foldcell.cell.record.words import COMMANDS, plain, recovery_in_words
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.observers import FAILING, Step
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.stages import FoldNote
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.ports import Side
from foldcell.skills.scoring.verdict import Score

RESULTS: Mapping[State, RunResult] = {
    State.FOLDED: "folded",
    State.NOT_FOLDED: "not_folded",
    State.STOPPED: "not_folded",
    State.FAULT: "fault",
}


class RunRecordBuilder:
    """Collects the events of a run, and makes the record after its end.

    began: time.monotonic() at the request [s]; resumed_from: the run that is resumed, else None.
    """

    def __init__(
        self, request: FoldRequest, simulated: bool, folder: Path, began: float, resumed_from: str | None = None
    ) -> None:
        self.request, self.simulated, self.folder = request, simulated, folder
        self._began, self._resumed_from = began, resumed_from
        self.events: tuple[RunEvent, ...] = ()
        """Failures, estimates, recoveries and commands so far, in order. It is replaced, so that any thread may
        read it."""
        self._grasps: dict[int, tuple[GraspRecord, ...]] = {}  # by the index of the fold

    def entered(self, t: float, step: Step) -> None: ...

    def performed(self, t: float, step: Step, result: Result) -> None:
        self.events = (*self.events, *_events(t, step, result))
        if step.effect is Effect.GRASP:
            fold = result.context.fold.index
            self._grasps[fold] = (*self._grasps.get(fold, ()), *_grasps(t, result))

    def record(
        self,
        end: RunEnd,
        score: Score | None = None,
        recording: RecordingLosses = NOTHING_LOST,
        signal: int | None = None,
    ) -> RunRecord:
        """Return the record. score: None if the garment was not scored, or not yet; signal: number of the signal
        that interrupted the run."""
        request, context = self.request, end.context
        resumed = f"resumed {self._resumed_from}" if self._resumed_from else ""
        first = (RunEvent(end.started, "command", resumed, ""),) if resumed else ()
        seen = context.recognition.perception if context.recognition else None
        return RunRecord(
            garment=request.garment,
            seed=request.seed,
            driver=request.driver,
            simulated=self.simulated,
            world=request.world if self.simulated else None,
            result=RESULTS[end.state],
            state=end.state,
            failure=_failure(end, request),
            score=None if score is None else ScoreRecord.of(score),
            steps=tuple(_folds(context, self._grasps)),
            robot_time_s=end.ended - end.started - context.waited_s,
            wall_time_s=time.monotonic() - self._began,
            stage_times_s={k: round(v, 3) for k, v in end.stage_times.items()},
            run_dir=str(self.folder),
            signal=signal,
            recording=recording,
            resumed_from=self._resumed_from,
            claim=context.claim(),
            recognised=None if seen is None else Recognised(seen.garment, seen.state.confidence),
            events=(*first, *self.events),
        )


def _events(t: float, step: Step, result: Result) -> Iterator[RunEvent]:
    """Yield the events of one effect, which ended at cell time t [s]."""
    failure, where = result.context.failure, plain(step.target)
    for t_command, command in result.within:
        yield RunEvent(t_command, "command", command, f"while {where}")
    if result.event in FAILING and failure is not None:
        hint = f" ({failure.hint})" if failure.hint else ""
        yield RunEvent(t, "failure", f"{plain(failure.kind)} while {where}", failure.what + hint)
    elif step.effect is Effect.CHOOSE_RECOVERY:
        yield RunEvent(t, "recovery", plain(result.event), recovery_in_words(result.event, result.record))
    elif step.effect is Effect.ESTIMATE:
        yield RunEvent(t, "estimate", "state of the garment", str(result.record.get("says", "")))
    elif "command" in result.record:
        yield RunEvent(t, "command", COMMANDS[Event(str(result.record["command"]))], f"while {where}")
    elif result.event is Event.PAUSE:
        yield RunEvent(t, "command", "pause", f"before {where}")


def _failure(end: RunEnd, request: FoldRequest) -> FailureRecord | None:
    failure = end.context.failure
    if failure is None or end.state is State.FOLDED:
        return None
    return FailureRecord(failure.kind, failure.what, failure.hint, deciding_setting(failure, request.settings))


def _grasps(t: float, result: Result) -> Iterator[GraspRecord]:
    """Yield the grasp of each hand that touched the garment. t: cell time at its end [s]."""
    failure = result.context.failure if result.event in FAILING else None
    record: Mapping[str, Any] = result.record
    for hand, height in record.get("contact_height_m", {}).items():
        felt: Mapping[str, Any] = {}
        if failure is None:
            held = result.context.fold.held[Side(hand)]
            felt = {"force_n": held.grip, "opening_m": held.opening, "layers": held.count.layers}
        elif failure.values.get("side") == hand:
            felt = failure.values
        yield GraspRecord(
            t=t,
            hand=hand,
            contact_height_m=height,
            contact_by=record["contact_by"][hand],
            grip_n=felt.get("force_n"),
            opening_m=felt.get("opening_m"),
            layers=felt.get("layers"),
            failed=failure.kind if failure else None,
        )


def _folds(context: RunContext, grasps: Mapping[int, tuple[GraspRecord, ...]]) -> Iterator[FoldRecord]:
    """Yield the record of each planned fold. The record of an unfinished fold has the figures that are known so
    far."""
    notes, done = context.notes(), {note.name for note in context.done}
    for index, step in enumerate(context.steps):
        recoveries = tuple(text for i, text in context.recoveries if i == index)
        estimates = tuple(note.says for note in context.estimates if note.fold == index)
        if step.name in notes:
            fold = _fold(notes[step.name], step.name in done)
        else:
            fold = FoldRecord(step.name, attempts=context.fold.grasps if index == context.fold.index else 0)
        repairs = tuple(text for i, text in context.repairs if i == index)
        yield replace(
            fold, grasps=grasps.get(index, ()), recoveries=recoveries, estimates=estimates, repairs=repairs
        )


def _fold(note: FoldNote, done: bool) -> FoldRecord:
    attempt, seen = note.attempt, note.inspected
    return FoldRecord(
        name=note.name,
        done=done,
        accepted=None if seen is None or (note.accepted and not done) else note.accepted,
        source=attempt.trajectory.source,
        simulations=attempt.trajectory.simulations,
        dissimilarity_m=known(attempt.dissimilarity_m),
        aligned_iou=known(seen.iou_aligned) if seen else None,
        observed_iou=known(seen.iou) if seen else None,
        drift_m=known(seen.drift_m) if seen else None,
        observed_height_m=known(seen.height_m) if seen else None,
        pressed_from_m=tuple(known(before.height_m) for before in attempt.pressed),
        duration_s=known(attempt.carrying_s),
        attempts=note.grasps,
    )
