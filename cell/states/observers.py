"""The protocol of a run's observers, and the step of the machine that they are notified of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from foldcell.cell.states.run_context import Result
from foldcell.cell.states.transition_table import Effect, Event, State

FAILING = frozenset({Event.FAILED, Event.CRASH, Event.STOP, Event.ABORT, Event.UNRECORDED})


@dataclass(frozen=True)
class Step:
    """One transition of the machine, with the effect to perform."""

    source: State
    event: Event
    target: State
    effect: Effect


class Observer(Protocol):
    """Receives each entered state and each performed effect. The methods must return immediately and not raise."""

    def entered(self, t: float, step: Step) -> None: ...

    def performed(self, t: float, step: Step, result: Result) -> None: ...
