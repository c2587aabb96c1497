"""Any failure in any state ends the run in a declared state with the cell safe and a reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import pytest

from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.runner import Runner
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.recovery_table import RECOVERIES
from foldcell.cell.states.run_context import Result, RunContext, RunEnd
from foldcell.cell.states.transition_table import TERMINAL, TRANSITIONS, Effect, Event, State
from foldcell.robots.errors import DriverError, Failure, FailureKind, InternalError, StorageError
from tests.builders.ways import WAYS
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

SAFE = frozenset({Effect.MAKE_SAFE, Effect.HOLD})
STILL = SAFE | {Effect.NOTHING, Effect.WAIT, Effect.CHOOSE_RECOVERY, Effect.ASK_OPERATOR, Effect.ASK_APPROVAL}
"""Effects that do not move the arms away from the safe pose."""
USUAL = {
    Effect.INSPECT: Event.ALL_FOLDED,
    Effect.NEXT_STEP: Event.ALL_FOLDED,
    Effect.REENTER: Event.LOOK_AGAIN,
} | {question: Event.ABORT for question in (Effect.ASK_APPROVAL, Effect.ASK_OPERATOR, Effect.WAIT)}
"""The event of each effect that succeeds. Other effects end with DONE."""
BUGS = (ZeroDivisionError("a bug"), AssertionError(), InternalError("a bug"), StorageError("a file is gone"))


class FakeJournal:
    """A journal that accepts every entry and keeps none."""

    def __init__(self) -> None:
        self._lines = count(1)

    def event(self, *_: Any) -> int:
        return next(self._lines)

    intent = result = event


def run_to(
    place: tuple[State, Effect], misbehave: Callable[[RunContext], Result], cell: Workcell
) -> tuple[RunEnd, list[Effect]]:
    """A run to this state, whose effect misbehaves each time. Returns the end of the run and its effects in
    order."""
    way = list(WAYS[place])
    journal_file: Any = FakeJournal()
    done: list[Effect] = []

    def effect_of(effect: Effect) -> Callable[[Any, RunContext], Result]:
        def perform(_: Any, context: RunContext) -> Result:
            done.append(effect)
            if not way and (runner.state, effect) == place:
                return misbehave(context)
            if way:
                event = way.pop(0).event
                return Result(event, context.with_failure(Failure(FailureKind.SLIPPED, "on the way")))
            if effect is Effect.CHOOSE_RECOVERY:
                return EFFECTS[Effect.CHOOSE_RECOVERY](cell, context)
            return Result(USUAL.get(effect, Event.DONE), context)

        return perform

    runner = Watched(cell, {effect: effect_of(effect) for effect in Effect}, journal_file, cell.commands)
    end = runner.run(first=way.pop(0).event)
    return end, done


class Watched(Runner):
    @property
    def state(self) -> State:
        return self._machine.state


def failing(failure: Failure) -> Callable[[RunContext], Result]:
    return lambda context: Result(Event.FAILED, context.with_failure(failure))


def raising(error: Exception) -> Callable[[RunContext], Result]:
    def misbehave(context: RunContext) -> Result:
        raise error

    return misbehave


def misbehaviours() -> Iterator[tuple[str, Callable[[RunContext], Result], bool]]:
    """All failures: a description, the misbehaviour, and whether the cell may recover automatically."""
    for kind in FailureKind:
        yield f"fails: {kind}", failing(Failure(kind, "it failed")), len(RECOVERIES[kind]) > 1
    for kind in (FailureKind.STOPPED, FailureKind.ABORTED, FailureKind.CAMERA_FAULT):
        yield f"raises: {kind}", raising(DriverError(kind, "it is gone")), len(RECOVERIES[kind]) > 1
    for bug in BUGS:
        yield repr(bug), raising(bug), False
    yield "an event that nobody knows", lambda context: Result(Event.START, context), False


def test_every_effect_is_reachable() -> None:
    assert {(row.target, row.effect) for row in TRANSITIONS if row.target not in TERMINAL} <= set(WAYS)


@pytest.mark.usefixtures("waits_pass_at_once")
@pytest.mark.parametrize("place", WAYS, ids=lambda place: f"{place[0]}-{place[1]}")
def test_any_failure_in_any_state_ends_safe_with_its_reason(place: tuple[State, Effect]) -> None:
    cell = fake_workcell(FakeCell())
    for what, misbehave, mendable in misbehaviours():
        end, done = run_to(place, misbehave, cell)
        if mendable and end.state is State.FOLDED:
            continue
        moved = max((k for k, effect in enumerate(done) if effect not in STILL), default=-1)
        assert end.state in TERMINAL - {State.FOLDED}, what
        assert SAFE & set(done[moved + 1 :]), f"{what}: {done[-4:]}"
        assert end.context.failure is not None, what
