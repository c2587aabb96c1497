"""The effects that end a run: what could not be made safe says why, and a stop leaves by its own way."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import cell.effects.moving as moving
from cell.context import Context
from cell.effects.moving import hold_still, make_safe, prepare
from cell.states import Event
from robots.errors import DriverError, Failure, FailureKind
from skills.vocabulary import Outcome
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

K = FailureKind
FIRST = Context().with_failure(Failure(K.CATEGORY_MISMATCH, "these are trousers"))


def test_a_parked_cell_is_made_safe_by_opening_the_hands() -> None:
    cell = FakeCell()
    cell.openings = dict.fromkeys(cell.openings, 0.0)
    result = make_safe(fake_workcell(cell), FIRST)
    assert result.event is Event.DONE
    assert set(cell.openings.values()) == {cell.ports().grippers["left"].max_opening}  # type: ignore[index]
    assert result.context.failure is FIRST.failure, "why the run ended stays known"


def test_a_stop_while_making_safe_is_told_as_a_stop() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    cell.at(0.3, lambda: workcell.ports.stop.trigger("button"))
    result = make_safe(workcell, FIRST)
    assert result.event is Event.FAILED
    assert result.context.failure.kind is K.STOPPED


def test_why_it_could_not_be_made_safe_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    no_way = Outcome(failure=Failure(K.UNREACHABLE, "no way up and home was found", "jog the arms by hand"))
    monkeypatch.setattr(moving, "plan_free_motion", lambda *_, **__: no_way)
    monkeypatch.setattr(moving, "plan_withdrawal", lambda *_, **__: no_way)
    result = make_safe(fake_workcell(FakeCell(q=np.full(14, 0.5))), FIRST)
    assert result.event is Event.FAILED
    assert result.context.failure.kind is K.UNREACHABLE and "by hand" in result.context.failure.hint


def test_a_driver_that_refuses_while_making_safe_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise DriverError(K.HARDWARE_FAULT, "the motors are off", "see the robot's screen")

    monkeypatch.setattr(moving, "wait", refuse)
    result = make_safe(fake_workcell(FakeCell()), FIRST)
    assert (result.event, result.context.failure.kind) == (Event.FAILED, K.HARDWARE_FAULT)


def test_a_stopped_cell_is_not_prepared() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell)
    workcell.ports.stop.trigger("button")
    result = prepare(workcell, Context())
    assert result.event is Event.FAILED and result.context.failure.kind is K.STOPPED
    assert cell.commands == []


def test_holding_commands_where_the_arms_stand() -> None:
    cell = FakeCell(q=np.full(14, 0.3))
    assert hold_still(fake_workcell(cell), FIRST).event is Event.DONE
    ((_, q),) = cell.commands
    np.testing.assert_array_equal(q, cell.q)


def test_holding_tells_a_stopped_robot_nothing() -> None:
    cell = FakeCell()
    workcell = fake_workcell(cell, robot=SimpleNamespace(q_park=np.zeros(14)))
    workcell.ports.stop.trigger("button")
    assert hold_still(workcell, FIRST).event is Event.DONE
    assert cell.commands == []
