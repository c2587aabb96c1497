"""The state machine of cell/states/transition_table.py: it receives an event and returns the effect to perform.

It has one thread, no clock, no I/O and no callbacks. The `transitions` library stores the rows, makes the
transitions, and draws the chart (benchmarks/state_chart.py). This module adds the rows outside the working flow
(stop, crash, abort, pause) for every working state.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from transitions import Machine, Transition

from foldcell.cell.states.observers import Step
from foldcell.cell.states.transition_table import TERMINAL, TRANSITIONS, Effect, Event, Row, State
from foldcell.robots.errors import InternalError

_ENDING = frozenset({State.GIVING_UP, State.MAKING_SAFE})


def complete_table(rows: tuple[Row, ...] = TRANSITIONS) -> tuple[Row, ...]:
    """Return the table with the rows that every working state has: stop, lost journal, crash, abort, pause and
    resume.

    A pause happens between two effects. RESUME enters the interrupted state again: the machine returns the same
    effect again, and the effect checks its start conditions itself. While the cell makes itself safe, it accepts
    no abort and no pause. A state with its own row for ABORT or CRASH gets no other.
    """
    own = {(row.state, row.event) for row in rows}
    working = [s for s in State if s not in TERMINAL and s not in {State.IDLE, State.PAUSED}]
    added = [Row(State.PAUSED, Event.RESUME, State.PAUSED, Effect.WAIT)]  # `handle` sets the target
    for s in [*working, State.PAUSED]:
        added.append(Row(s, Event.STOP, State.STOPPED, Effect.HOLD))
        added.append(Row(s, Event.UNRECORDED, State.FAULT, Effect.HOLD))
        if s in _ENDING:
            added.append(Row(s, Event.CRASH, State.FAULT, Effect.HOLD))
            continue
        if (s, Event.CRASH) not in own:
            added.append(Row(s, Event.CRASH, State.MAKING_SAFE, Effect.MAKE_SAFE))
        if (s, Event.ABORT) not in own:
            added.append(Row(s, Event.ABORT, State.GIVING_UP, Effect.MAKE_SAFE))
        if s is not State.PAUSED:
            added.append(Row(s, Event.PAUSE, State.PAUSED, Effect.WAIT))
    return (*rows, *added)


@dataclass
class _Model:
    """The model object that `transitions` requires. It contains only the state."""

    state: str = State.IDLE.value
    trigger: object = field(default=None, repr=False)


class _Transition(Transition):
    """A row of the table, with its effect."""

    def __init__(self, *args: Any, effect: Effect, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.effect = effect


class _Machine(Machine):
    transition_cls = _Transition


class Executive:
    """The state machine. `handle` raises InternalError for an event that has no row in the present state."""

    def __init__(self, rows: tuple[Row, ...] = TRANSITIONS) -> None:
        self._model = _Model()
        self._interrupted: tuple[State, Effect] | None = None
        self._effect = Effect.NOTHING
        self._machine = _Machine(
            model=self._model, states=[s.value for s in State], initial=State.IDLE.value,
            auto_transitions=False, send_event=False, model_override=False,
        )  # fmt: skip
        known: set[tuple[State, Event]] = set()
        for row in complete_table(rows):
            if (row.state, row.event) in known:
                raise InternalError(f"two rows of the table share the state '{row.state}' and event '{row.event}'")
            known.add((row.state, row.event))
            self._machine.add_transition(row.event.value, row.state.value, row.target.value, effect=row.effect)

    @property
    def state(self) -> State:
        return State(self._model.state)

    @property
    def ended(self) -> bool:
        return self.state in TERMINAL

    def allowed(self) -> tuple[Event, ...]:
        """Return the events that have a row in the present state, for buttons and messages."""
        return tuple(Event(t) for t in self._machine.get_triggers(self._model.state))

    def handle(self, event: Event) -> Step:
        """Make the transition for an event. Returns the transition with the effect to perform."""
        source = self.state
        lays_back = self._interrupted is not None and self._interrupted[1] is Effect.LAY_BACK
        # cloth in the hands is laid down also after an abort
        goes_on = event is Event.RESUME or (event is Event.ABORT and lays_back)
        if source is State.PAUSED and self._interrupted and goes_on:
            target, effect = self._interrupted
            self._machine.set_state(target.value, self._model)
            self._interrupted, self._effect = None, effect
            return Step(source, event, target, effect)
        if event is Event.ABORT and source is State.PAUSED and self._interrupted:
            self._machine.set_state(self._interrupted[0].value, self._model)  # its hands may carry cloth
        row = self._transition(self.state, event)
        if row is None:
            raise InternalError(
                f"event '{event}' in state '{source}'", f"known there: {', '.join(self.allowed()) or 'none'}"
            )
        if event is Event.PAUSE:
            self._interrupted = (source, self._effect)
        self._model.trigger(event.value)  # type: ignore[operator]
        self._effect = row.effect
        return Step(source, event, self.state, row.effect)

    def _transition(self, state: State, event: Event) -> _Transition | None:
        row = next(iter(self._machine.get_transitions(event.value, state.value)), None)
        return row if isinstance(row, _Transition) else None
