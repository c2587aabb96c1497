"""Determine the event and the context with which an interrupted run is resumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.transition_table import HANDS_CARRY_CLOTH, REENTRIES, Event, State


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
