"""Who is told what happens in a run: the observers' protocol, and what they are told of the machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from cell.states.run_context import Result
from cell.states.transition_table import Effect, Event, State

__all__ = ["FAILING", "Observer", "Step"]

FAILING = frozenset({Event.FAILED, Event.CRASH, Event.STOP, Event.ABORT, Event.UNRECORDED})


@dataclass(frozen=True)
class Step:
    """One turn of the machine."""

    source: State
    event: Event
    target: State
    effect: Effect


class Observer(Protocol):
    """Is told what happens. Must return at once and never raise."""

    def entered(self, t: float, step: Step) -> None: ...

    def performed(self, t: float, step: Step, result: Result) -> None: ...
