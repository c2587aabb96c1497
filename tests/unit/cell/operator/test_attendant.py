"""The person at a real cell: questions, waits, and the ends of waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from foldcell.cell.operator.terminal.attendant import PersonAttendant
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.observers import Step
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import BoardPlace
from tests.builders.records import run_status
from tests.fakes import FakeCell


class Asked:
    """An attendant who is asked on another thread."""

    def __init__(self) -> None:
        self.cell, self.commands = FakeCell(), CommandQueue()
        self.asked: list[str | None] = []
        self.refused: DriverError | None = None
        self.person = PersonAttendant(self.commands, self.cell.ports().stop, self.asked.append)

    def ask(self, what: Callable[[], None]) -> threading.Thread:
        def asking() -> None:
            try:
                what()
            except DriverError as e:
                self.refused = e

        thread = threading.Thread(target=asking, daemon=True)
        thread.start()
        until(lambda: self.asked)
        return thread


def until(so: Callable[[], Any]) -> None:
    for _ in range(3000):
        if so():
            return
        time.sleep(0.01)
    raise AssertionError("never")


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_the_attendant_waits_for_the_confirmation(asked: Asked) -> None:
    thread = asked.ask(asked.person.lay_garment)
    assert thread.is_alive() and "lay the garment flat" in str(asked.asked[0])
    asked.commands.put(Event.PAUSE)
    thread.join(0.3)
    assert thread.is_alive()
    asked.commands.put(Event.APPROVE)
    thread.join(10.0)
    assert not thread.is_alive() and asked.asked[1:] == [None]


def test_an_approval_before_the_question_is_no_confirmation(asked: Asked) -> None:
    asked.commands.put(Event.APPROVE)
    thread = asked.ask(asked.person.lay_garment)
    thread.join(0.3)
    assert thread.is_alive()
    asked.commands.put(Event.APPROVE)
    thread.join(10.0)
    assert not thread.is_alive()


def test_an_abort_is_no_confirmation(asked: Asked) -> None:
    """Otherwise the next effect would begin, and pads could close on fingers."""
    thread = asked.ask(lambda: asked.person.bring_board(BoardPlace.LEFT_HAND))
    assert "left gripper" in str(asked.asked[0])
    asked.commands.put(Event.ABORT)
    thread.join(10.0)
    assert asked.refused is not None and asked.refused.kind is FailureKind.ABORTED
    assert asked.asked[-1] is None and asked.commands.take({Event.ABORT}) is None, (
        "the abort is not left in the queue"
    )


def test_a_closed_terminal_ends_the_wait(asked: Asked) -> None:
    """Otherwise the robot would wait forever with its motors on."""
    thread = asked.ask(asked.person.lay_garment)
    asked.commands.close()
    for _ in range(2):  # the next question ends too
        thread.join(10.0)
        assert not thread.is_alive()
        assert asked.refused is not None and asked.refused.kind is FailureKind.ABORTED
        asked.refused = None
        thread = asked.ask(lambda: asked.person.bring_board(BoardPlace.AWAY))
    thread.join(10.0)


def test_a_stop_ends_the_wait(asked: Asked) -> None:
    thread = asked.ask(asked.person.lay_garment)
    asked.cell.stop_reason = "the button"
    thread.join(10.0)
    assert asked.refused is not None and asked.refused.kind is FailureKind.STOPPED and asked.asked[-1] is None


def test_a_script_continues_while_the_attendant_waits(asked: Asked) -> None:
    """The wait advances the cell's clock, which carries out the script."""
    clock = asked.cell.ports().clock
    asked.person.clock = clock
    asked.cell.at(0.5, lambda: asked.commands.put(Event.APPROVE) and None)
    thread = asked.ask(asked.person.lay_garment)
    thread.join(10.0)
    assert not thread.is_alive() and asked.refused is None and clock.now() >= 0.5


def test_the_page_shows_the_question_and_takes_the_answer() -> None:
    board = run_status(simulated=False)
    board.entered(1.0, Step(State.PHOTOGRAPHING, Event.DONE, State.AWAITING_GARMENT, Effect.AWAIT_GARMENT))
    assert Event.APPROVE not in board.allowed() and board.snapshot()["question"] is None
    board.ask("lay the garment flat")
    question = board.snapshot()["question"]
    assert "lay the garment flat" in question["text"] and board.answers(question["number"])
    assert Event.APPROVE in board.allowed() and Event.PAUSE not in board.allowed()
    board.ask(None)
    assert board.snapshot()["question"] is None and Event.APPROVE not in board.allowed()
    board.ask("lay it again")
    assert not board.answers(question["number"]), "an answer to an earlier question is refused"
