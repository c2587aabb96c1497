"""Decide from the journal and the run's folder whether a run can be resumed, and with which event and context."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.journal.checkpoint_file import has_checkpoint
from foldcell.cell.journal.journal import Journal
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import HANDS_CARRY_CLOTH, REENTRIES, Event, State
from foldcell.robots.errors import ConfigurationError

__all__ = ["RESUMED_FROM", "check_resumable", "last_begun", "reentered", "reentry_event", "resumable"]

RESUMED_FROM = "resumed_from"
"""Name of the journal event that marks a run as the continuation of another run."""
CALIBRATION = "calibrate-"
"""Prefix in the journal's garment field that marks a calibration."""


def resumable(journal: Journal, name: str) -> bool:
    """Whether `foldcell resume` accepts the run, if the run's files are undamaged."""
    try:
        check_resumable(journal, name)
    except ConfigurationError:
        return False
    return True


def last_begun(journal: Journal) -> str:
    """Return the id of the newest run that began to act, or of the newest run if none did."""
    runs = journal.runs()
    return next((run.id for run in reversed(runs) if journal.began_to_act(run.id)), journal.run("last").id)


def check_resumable(journal: Journal, name: str) -> None:
    """Check that a run can be resumed. Raises ConfigurationError with the reason if it cannot. name: id of the
    run."""
    runs = journal.runs()
    index = next(n for n, r in enumerate(runs) if r.id == name)
    record, later = runs[index], runs[index + 1 :]
    if record.status == "running":
        raise ConfigurationError(f"the run {name} is still running (process {record.pid})", "stop it first")
    if record.status == "folded":
        raise ConfigurationError(f"the run {name} has folded its garment", "there is nothing to resume")
    if record.garment.startswith(CALIBRATION):
        raise ConfigurationError(f"{name} is a calibration: it cannot be resumed", "start it again")
    if not record.directory.is_dir():
        raise ConfigurationError(f"the folder of the run {name} is gone", "start a new one: foldcell fold")
    successors = [run for run, entry in journal.named(RESUMED_FROM) if entry.payload["run"] == name]
    if successors:
        newest = successors[-1]
        raise ConfigurationError(f"the run {name} was already resumed as {newest}", f"foldcell resume {newest}")
    runs_since = [
        other.id
        for other in later
        if other.driver == record.driver and not is_simulated(record.driver) and journal.began_to_act(other.id)
    ]
    if runs_since:
        raise ConfigurationError(
            f"the cell has done other runs since {name} (the last is {runs_since[-1]})",
            "lay the garment flat and start a new one",
        )
    if not has_checkpoint(record.directory):
        raise ConfigurationError(
            f"the run {name} has no checkpoint: it had not begun, or ended with folds skipped",
            "start a new one: foldcell fold",
        )


def reentry_event(states: Sequence[State], context: RunContext) -> Event:
    """Return the event with which a run is resumed. states: the states through which the run passed; context: its
    saved context."""
    events = [REENTRIES[state] for state in states if state in REENTRIES]
    # no such state: this run resumed another run and was interrupted early; resume with the same event again
    event = events[-1] if events else context.reentry or Event.START_OVER
    if event is Event.LOOK_AFTER and context.fold.attempt is None:  # the next fold has not begun
        return Event.LOOK_AGAIN
    if (
        _interrupted_in(states) in HANDS_CARRY_CLOTH and context.fold.carried
    ):  # the hands completed the fold; only the release is missing
        return Event.LOOK_AFTER
    return event


def reentered(states: Sequence[State], context: RunContext, event: Event) -> RunContext:
    """Return the context to resume with. Grasps, waiting time and failure are removed from it. states, context: as
    in `reentry_event`, which gave the event."""
    if event is Event.START_OVER:
        return RunContext(reentry=event)
    # the saved context is older than a grasp that was interrupted
    touched = context.fold.touched or _interrupted_in(states) is State.GRASPING
    fold = replace(context.fold, held={}, biases={}, carrying=(), touched=touched)
    if fold.attempt:  # the saved `carried` is also true if the release did not end
        fold = replace(fold, attempt=replace(fold.attempt, carried=event is Event.LOOK_AFTER))
    return replace(context, reentry=event, fold=fold, failure=None, cause=None, waited_s=0.0)


def _interrupted_in(states: Sequence[State]) -> State | None:
    """Return the latest state that says how the garment lies."""
    return next((state for state in reversed(states) if state in REENTRIES), None)
