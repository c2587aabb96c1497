"""The event and the context with which an interrupted run is resumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cell.states.run_context import RunContext
from cell.states.transition_table import REENTRIES, Event, State

__all__ = ["reentered", "reentry_event"]


def reentry_event(states: Sequence[State], context: RunContext) -> Event:
    """The event with which to resume a run that passed through `states` and left `context`."""
    events = [REENTRIES[state] for state in states if state in REENTRIES]
    # without such a state, this run resumed another one and came no further
    event = events[-1] if events else context.reentry or Event.START_OVER
    if event is Event.LOOK_AFTER and context.fold.attempt is None:  # fold inspected, next one not begun
        return Event.LOOK_AGAIN
    return event


def reentered(context: RunContext, event: Event) -> RunContext:
    """The context to resume with: without grasps, waiting time and failure."""
    if event is Event.START_OVER:
        return RunContext(reentry=event)
    fold = replace(context.fold, held={}, biases={})
    if fold.attempt:  # carried is also true if the release was begun but not ended
        fold = replace(fold, attempt=replace(fold.attempt, carried=event is Event.LOOK_AFTER))
    return replace(context, reentry=event, fold=fold, failure=None, waited_s=0.0)
