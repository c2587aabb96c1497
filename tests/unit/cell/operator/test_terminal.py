"""Operator commands from the terminal, and progress lines."""

import io
import os
import re
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest

from foldcell.cell.operator.progress.lines import ProgressLines
from foldcell.cell.operator.terminal.keys import KEYS, TerminalOperator
from foldcell.cell.states.commands import OPERATOR_EVENTS, CommandQueue
from foldcell.cell.states.observers import Step
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.transition_table import Effect, Event, State
from foldcell.robots.errors import Failure, FailureKind
from tests.builders.contexts import context_with


def typed(text: str) -> tuple[CommandQueue, str]:
    commands, answers = CommandQueue(), io.StringIO()
    operator = TerminalOperator(commands, io.StringIO(text), answers)
    operator.start()
    operator.join(5)
    return commands, answers.getvalue()


def test_letters_and_words_become_commands_in_order() -> None:
    commands, _ = typed("a\n RETRY \n")
    assert commands.take({Event.APPROVE}) is Event.APPROVE
    assert commands.take({Event.RETRY}) is Event.RETRY


def test_every_operator_command_has_a_key() -> None:
    assert set(KEYS.values()) == OPERATOR_EVENTS


def test_an_unknown_command_is_reported_and_ignored() -> None:
    commands, answers = typed("\nfold it\n")
    assert "'fold it' is no command" in answers
    assert commands.take(OPERATOR_EVENTS) is Event.ABORT  # the abort comes from the end of the input


def test_a_command_that_is_not_allowed_now_is_refused() -> None:
    """Otherwise the operator would believe that a void command was accepted: an answer before the question, or a
    resume without a pause."""
    commands, answers = CommandQueue(), io.StringIO()
    may = {Event.PAUSE, Event.ABORT}
    operator = TerminalOperator(commands, io.StringIO(), answers, may=lambda: frozenset(may))
    operator.take("s")
    assert "skip: this command is not possible now" in answers.getvalue() and "accepted" not in answers.getvalue()
    assert commands.take(OPERATOR_EVENTS) is None
    may.add(Event.SKIP)
    operator.take("s")
    assert "skip: accepted" in answers.getvalue() and commands.take(OPERATOR_EVENTS) is Event.SKIP


def test_a_closed_terminal_aborts_the_run() -> None:
    commands, _ = typed("")
    assert commands.take({Event.ABORT}) is Event.ABORT


STEP = Step(State.GRASPING, Event.DONE, State.LIFTING, Effect.LIFT)


def test_progress_shows_state_and_time() -> None:
    stream = io.StringIO()
    ProgressLines(stream).entered(12.34, STEP)
    assert stream.getvalue() == "    12.3 s  lifting\n"


def test_progress_shows_the_open_question() -> None:
    stream = io.StringIO()
    waiting = Step(State.PLANNING_MOTION, Event.APPROVAL_NEEDED, State.AWAITING_APPROVAL, Effect.ASK_APPROVAL)
    lines = ProgressLines(stream)
    lines.entered(1.0, waiting)
    assert "approve the fold (a)" in stream.getvalue()
    repair: Any = SimpleNamespace(in_words=lambda: "the hands carry the cloth on")
    lines.performed(2.0, waiting, Result(Event.APPROVAL_NEEDED, context_with(repair=repair)))
    lines.entered(3.0, waiting)
    *_, asked = stream.getvalue().splitlines()
    assert "the hands carry the cloth on: approve the repair (a)" in asked and "(s)" not in asked


def test_progress_shows_a_failure_once() -> None:
    stream = io.StringIO()
    lines = ProgressLines(stream)
    context = RunContext().with_failure(Failure(FailureKind.MISSED_GRASP, "nothing between the pads", "regrasp"))
    lines.performed(2.0, STEP, Result(Event.FAILED, context))
    lines.performed(3.0, STEP, Result(Event.DONE, context))  # the context still has the earlier failure
    assert stream.getvalue().count("missed_grasp: nothing between the pads (regrasp)") == 1


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_progress_bar_is_cleared_before_the_next_line() -> None:
    screen = Screen()
    lines = ProgressLines(screen)
    lines.computing(3, 60, "simulations at most")
    lines.entered(2.0, STEP)
    assert re.fullmatch(
        r"\r\[.+\] 3/60  simulations at most.*\x1b\[K\r\x1b\[K     2.0 s  lifting\n", screen.getvalue()
    )


def test_progress_without_a_stream_writes_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    lines = ProgressLines(None)
    lines.computing(3, 60, "simulations at most")
    lines.entered(2.0, STEP)
    assert capfd.readouterr() == ("", "")


def test_progress_continues_if_its_reader_is_gone() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        lines = ProgressLines(stream)
        lines.entered(0.0, STEP)
        lines.entered(1.0, STEP)
        with suppress(BrokenPipeError):
            stream.close()


def test_the_terminals_next_line_goes_to_the_next_run() -> None:
    """Runs of a campaign share a terminal. A typed line goes to the current run."""
    ours, theirs = os.pipe()
    first, second = CommandQueue(), CommandQueue()
    with os.fdopen(ours) as source, os.fdopen(theirs, "w") as keyboard:
        TerminalOperator(first, source, io.StringIO()).start()
        print("a", file=keyboard, flush=True)
        assert first.wait({Event.APPROVE}, 10.0) is Event.APPROVE
        last = TerminalOperator(second, source, io.StringIO())
        last.start()
        print("r", file=keyboard, flush=True)
        assert second.wait({Event.RETRY}, 10.0) is Event.RETRY and first.take(OPERATOR_EVENTS) is None
        keyboard.close()
        assert second.wait({Event.ABORT}, 10.0) is Event.ABORT and first.take(OPERATOR_EVENTS) is None
        third = CommandQueue()
        TerminalOperator(third, source, io.StringIO()).start()
        assert third.wait({Event.ABORT}, 10.0) is Event.ABORT, "a run on a closed terminal is aborted"
