"""Properties of every run: random outcomes, commands, stops and faults through the runner and the machine.

A life first goes the shortest way to a drawn state. Then each move is what happens in one effect: its outcome, and
what arrives meanwhile. When the moves are used up, every effect succeeds, or one of them fails each time for the
rest of the run. Effects that choose a recovery are the real ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.machine import Executive, complete_table
from foldcell.cell.executive.runner import Runner
from foldcell.cell.runs.reentry import reentered, reentry_event
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.transition_table import HANDS_CARRY_CLOTH, TERMINAL, Effect, Event, State
from foldcell.robots.errors import DriverError, Failure, FailureKind, InternalError, StorageError
from tests.builders.contexts import context_with
from tests.builders.ways import WAYS
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

ENDING = {Effect.HOLD, Effect.NOTHING}
USUAL = {
    Effect.INSPECT: Event.ALL_FOLDED,
    Effect.NEXT_STEP: Event.ALL_FOLDED,
    Effect.ASK_APPROVAL: Event.APPROVE,
    Effect.ASK_OPERATOR: Event.ABORT,
    Effect.WAIT: Event.RESUME,
}
"""The event of each effect that succeeds. Other effects end with DONE."""
ON_THE_CLOTH = {Effect.GRASP, Effect.LIFT, Effect.FOLD, Effect.RELEASE, Effect.PRESS}
OUTSIDE = {Event.STOP, Event.UNRECORDED, Event.PAUSE, Event.CRASH}
"""Events that the runner makes itself."""
ROWS = {state: sorted({row.event for row in complete_table() if row.state is state} - OUTSIDE) for state in State}
NEXT = [Event.NEXT_FOLD, Event.ALL_FOLDED, Event.GIVE_UP]
"""The events of NEXT_STEP, which shares its state with an inspection."""
BEFORE = {
    Effect.APPROACH: {Effect.CHECK_PLACE},
    Effect.CHECK_PLACE: {Effect.PLAN_MOTION, Effect.ASK_APPROVAL},
    Effect.GRASP: {Effect.APPROACH},
    Effect.LIFT: {Effect.GRASP},
    Effect.FOLD: {Effect.LIFT},
    Effect.PRESS: {Effect.INSPECT, Effect.ASK_APPROVAL},
}
"""The only effects that may come immediately before an effect that works on the garment."""
AFTER_A_RECOVERY = 30
"""More effects than any way through the table from one recovery to the next."""
QUICK = {"patience": 3.0}


@dataclass(frozen=True)
class Move:
    """What happens in one effect. outcome: `usual`, `chosen` (an event of the state's rows, by its number),
    `alien` (an event without a row), `bug`, `fails` (the effect returns a failure) or `raises` (the driver raises
    one). meanwhile: a command, or `stop` (after_s later), `unrecorded` (the journal is lost) or `unsaved` (the
    checkpoint cannot be written)."""

    outcome: str = "usual"
    kind: FailureKind = FailureKind.SLIPPED
    number: int = 0
    meanwhile: Event | str | None = None
    after_s: float = 0.0


COMMANDS = (Event.PAUSE, Event.RESUME, Event.APPROVE, Event.RETRY, Event.SKIP, Event.ABORT)
OUTCOMES = (*("usual",) * 8, *("chosen",) * 3, *("fails",) * 5, "raises", "bug", "alien")
MOVES = st.builds(
    Move,
    st.sampled_from(OUTCOMES),
    st.sampled_from((*FailureKind, *(FailureKind.STOPPED,) * 4)),
    st.integers(0, 9),
    st.sampled_from((*(None,) * 16, *COMMANDS, Event.PAUSE, Event.PAUSE, *("stop",) * 4, "unrecorded", "unsaved")),
    st.sampled_from((0.0, 0.5, 1.5)),
)
WORKING = {
    State.APPROACHING,
    State.GRASPING,
    *HANDS_CARRY_CLOTH,
    State.RELEASING,
    State.PRESSING,
    State.LAYING_BACK,
}
PLACES = sorted(WAYS) + 3 * [place for place in sorted(WAYS) if place[0] in WORKING]
ALWAYS = st.none() | st.tuples(st.sampled_from(Effect), st.sampled_from(FailureKind))


@dataclass(frozen=True)
class Line:
    kind: str
    state: State
    name: str
    answers: int | None = None


class FakeJournal:
    """Keeps the entries in memory. When it is lost, it accepts none."""

    def __init__(self) -> None:
        self.lines: list[Line] = []
        self.lost = False

    def _keep(self, line: Line) -> int:
        if self.lost:
            raise StorageError("the disk is full", "free some space")
        self.lines.append(line)
        return len(self.lines) - 1

    def event(self, t: float, state: str, name: str, payload: Any = None) -> int:
        return self._keep(Line("event", State(state), name))

    def intent(self, t: float, state: str, name: str, payload: Any = None) -> int:
        return self._keep(Line("intent", State(state), name))

    def result(self, intent: int, t: float, payload: Mapping[str, Any]) -> int:
        return self._keep(Line("result", self.lines[intent].state, payload["event"], intent))


class Watched(Runner):
    @property
    def state(self) -> State:
        return self._machine.state


class EndlessRun(BaseException):
    """No part of the program handles it."""


@dataclass
class Life:
    """One run and all that happens in it."""

    moves: list[Move]
    way: list[Event] = field(default_factory=list)
    always: tuple[Effect, FailureKind] | None = None
    attended: bool = False
    stop_in_choice: float | None = None
    """A stop follows so long after the cell began to choose its first recovery [s]."""
    reenter: Event = Event.LOOK_AGAIN
    performed: list[tuple[State, Effect]] = field(default_factory=list)
    ended: list[Event | None] = field(default_factory=list)
    """The event of each effect; None if it raised an exception."""
    saved: list[tuple[int, RunContext]] = field(default_factory=list)
    """Number of journal entries, and the context of the checkpoint."""
    after_stop: list[Effect] = field(default_factory=list)
    waited_on: list[float] = field(default_factory=list)
    """For how long a choice of a recovery, which may wait, went on after a stop [s]."""
    stopped_at: float | None = None
    unsaved: bool = False
    triggered: bool = False

    def __post_init__(self) -> None:
        self.cell, self.journal = FakeCell(), FakeJournal()
        self.workcell = fake_workcell(self.cell, attended=self.attended)
        shipped = self.workcell.settings
        quick = shipped.model_copy(update={"recovery": shipped.recovery.model_copy(update=QUICK)})
        self.workcell = replace(self.workcell, settings=quick)
        bounds = quick.recovery
        self.bound = AFTER_A_RECOVERY * (len(self.moves) + bounds.attempts_per_run + 8)

    def live(self, context: RunContext | None = None) -> RunEnd:
        first = self.way.pop(0)
        effects = {effect: self._effect(effect) for effect in Effect}
        journal: Any = self.journal
        self.runner = Watched(self.workcell, effects, journal, self.workcell.commands, (), self._save)
        return self.runner.run(context, first)

    def _save(self, context: RunContext) -> None:
        if self.unsaved:
            raise StorageError("the disk is full", "free some space")
        self.saved.append((len(self.journal.lines), context))

    def _effect(self, effect: Effect) -> Callable[[Any, RunContext], Result]:
        def perform(cell: Any, context: RunContext) -> Result:
            if len(self.performed) > self.bound:
                raise EndlessRun
            self.performed.append((self.runner.state, effect))
            if self.stopped_at is not None:
                self.after_stop.append(effect)
            self.ended.append(None)
            before = self.stopped_at
            result = self._outcome(cell, effect, context)
            if effect is Effect.CHOOSE_RECOVERY and self.stopped_at is not None and before is None:
                self.waited_on.append(self.cell.now - self.stopped_at)
            self.ended[-1] = result.event
            return result

        return perform

    def _outcome(self, cell: Any, effect: Effect, context: RunContext) -> Result:
        if self.way:
            failure = Failure(FailureKind.NO_GARMENT, "on the way")
            return Result(self.way.pop(0), context.with_failure(failure))
        move = self.moves.pop(0) if self.moves else Move()
        self._meanwhile(move)
        if effect is Effect.CHOOSE_RECOVERY:
            if self.stop_in_choice is not None:
                self._stop_in(self.stop_in_choice)
            return EFFECTS[effect](cell, context)
        self.cell.ports().clock.sleep_until(self.cell.now + 1.0)
        if effect is Effect.PHOTOGRAPH_TABLE and move.outcome == "usual":
            context = context_with(context, reference=cell.ports.camera.capture())
        if effect in ENDING:
            return Result(Event.DONE, context)
        if self.always and self.always[0] is effect:
            move = replace(move, outcome="fails", kind=self.always[1])
        failure = Failure(move.kind, "it failed")
        if move.kind is FailureKind.STOPPED and move.outcome in ("fails", "raises"):  # the effect saw a stop
            self.stopped_at = self.cell.now
        if move.outcome == "fails":
            return Result(Event.FAILED, context.with_failure(failure))
        if move.outcome == "raises":
            raise DriverError(move.kind, "it is gone")
        if move.outcome == "bug":
            raise ZeroDivisionError("a bug")
        if move.outcome == "alien":
            return Result(Event.START, context.with_failure(failure))
        rows = NEXT if effect is Effect.NEXT_STEP else ROWS[self.runner.state]
        if move.outcome == "chosen" and rows:
            return Result(rows[move.number % len(rows)], context.with_failure(failure))
        return Result(self.reenter if effect is Effect.REENTER else USUAL.get(effect, Event.DONE), context)

    def _meanwhile(self, move: Move) -> None:
        if move.meanwhile == "unrecorded":
            self.journal.lost = True
        elif move.meanwhile == "unsaved":
            self.unsaved = True
        elif move.meanwhile == "stop":
            self._stop_in(move.after_s)
        elif move.meanwhile is not None:
            self.workcell.commands.put(Event(move.meanwhile))

    def _stop_in(self, seconds: float) -> None:
        def stop() -> None:
            self.cell.ports().stop.trigger("the button")
            self.stopped_at, self.triggered = moment, True

        moment = self.cell.now + seconds
        self.cell.at(moment, stop)


WAY = st.sampled_from(PLACES).map(lambda place: [row.event for row in WAYS[place]])
STOPS_IN_A_CHOICE = st.sampled_from((None, None, None, 0.5))
LIVES = st.builds(Life, st.lists(MOVES, max_size=30), WAY, ALWAYS, st.booleans(), STOPS_IN_A_CHOICE)


@settings(max_examples=300, deadline=None)
@given(LIVES, st.floats(0.0, 1.0))
def test_random_runs_hold_the_invariants(life: Life, killed: float) -> None:
    end = life.live()
    ends_in_a_declared_state_with_its_reason(life, end)
    nothing_begins_after_a_stop_but_holding(life)
    nothing_leaves_the_end(life)
    the_journal_replays_to_the_same_states(life, end)
    hands_approach_only_after_a_plan_and_a_picture(life)
    cloth_in_the_hands_is_laid_down_first(life)
    a_killed_run_is_resumed_with_a_look(life, round(killed * len(life.journal.lines)))


def ends_in_a_declared_state_with_its_reason(life: Life, end: RunEnd) -> None:
    assert end.state in TERMINAL
    assert end.state is State.FOLDED or end.context.failure is not None
    assert life.performed[-1][1] in ENDING, "the arms rest, or nothing remains to be done"


def nothing_begins_after_a_stop_but_holding(life: Life) -> None:
    assert set(life.after_stop) <= ENDING
    if life.stopped_at is not None:
        assert [t for t, _ in life.cell.commands if t > life.stopped_at] == []
        assert max(life.waited_on, default=0.0) <= 2 * TICK_S, "a wait ends with the stop"
    assert bool(life.cell.stop_reason) == life.triggered, "only a person resets the stop"


def nothing_leaves_the_end(life: Life) -> None:
    assert life.runner._machine.ended and life.runner._machine.allowed() == ()
    for event in Event:
        with pytest.raises(InternalError):
            life.runner._machine.handle(event)


def the_journal_replays_to_the_same_states(life: Life, end: RunEnd) -> None:
    machine, lost = Executive(), life.journal.lost or life.unsaved
    for line in (line for line in life.journal.lines if line.kind == "event"):
        machine.handle(Event(line.name))
        assert machine.state is line.state
    assert machine.state is end.state or (lost and end.state is State.FAULT)
    answered = [line.answers for line in life.journal.lines if line.kind == "result"]
    intents = [k for k, line in enumerate(life.journal.lines) if line.kind == "intent"]
    assert answered == intents[: len(answered)] and len(intents) - len(answered) <= lost


def hands_approach_only_after_a_plan_and_a_picture(life: Life) -> None:
    worked = [effect for _, effect in life.performed if effect is not Effect.WAIT]
    for before, effect in pairwise(worked):
        assert before in BEFORE.get(effect, {before}), (before, effect)


def cloth_in_the_hands_is_laid_down_first(life: Life) -> None:
    """Except after a pause in which an arm was pushed: then no path leads anywhere, and the cell is made safe."""
    worked = [
        (state, effect, event)
        for (state, effect), event in zip(life.performed, life.ended, strict=True)
        if effect is not Effect.WAIT or event not in {Event.RESUME, Event.ABORT}
    ]
    for (state, effect, event), (_, following, _) in pairwise(worked):
        if state in HANDS_CARRY_CLOTH and effect is not Effect.WAIT and event is not Event.DONE:
            assert following in {Effect.LAY_BACK, Effect.HOLD, Effect.WAIT}, following


def a_killed_run_is_resumed_with_a_look(life: Life, killed: int) -> None:
    """The journal was written up to this number of lines when the process was killed."""
    states = [line.state for line in life.journal.lines[:killed] if line.kind == "event"]
    context = next((c for at, c in reversed(life.saved) if at <= killed), RunContext())
    event = reentry_event(states, context)
    again = Life([], [Event.REENTER], reenter=event)
    end = again.live(reentered(states, context, event))
    assert end.state is State.FOLDED
    order = [effect for _, effect in again.performed]
    looked = order.index(Effect.LOOK)
    assert not ON_THE_CLOTH & set(order[:looked]), "the hands are opened and the cell looks first"
    hands_approach_only_after_a_plan_and_a_picture(again)
