"""Where an interrupted run is resumed, and what it still believes then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cell.states.run_context import RunContext
from cell.states.transition_table import REENTRIES, Event, State

__all__ = ["reentered", "reentry_event"]


def reentry_event(states: Sequence[State], context: RunContext) -> Event:
    """The event that leads into a run that passed through `states` and left `context`."""
    known = [REENTRIES[state] for state in states if state in REENTRIES]
    event = known[-1] if known else context.reentry or Event.START_OVER  # resumed before, but no further
    if event is Event.LOOK_AFTER and context.fold.attempt is None:  # judged already, the next fold not begun
        return Event.LOOK_AGAIN
    return event


def reentered(context: RunContext, event: Event) -> RunContext:
    """The context to resume with: nothing is held, waited for or failed any more."""
    if event is Event.START_OVER:
        return RunContext(reentry=event)
    fold = replace(context.fold, held={}, biases={})
    if fold.attempt:  # carried also where the release was begun, and not ended
        fold = replace(fold, attempt=replace(fold.attempt, carried=event is Event.LOOK_AFTER))
    return replace(context, reentry=event, fold=fold, failure=None, waited_s=0.0)
