"""Operator commands during a calibration: abort at any time, approve for an open question."""

from __future__ import annotations

import io

from foldcell.cell.calibrating.session import CalibrationPrompts
from foldcell.cell.operator.terminal.keys import TerminalOperator
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.transition_table import Event


def test_only_an_open_question_can_be_approved() -> None:
    said: list[str] = []
    asking = CalibrationPrompts(said.append)
    assert asking.may() == {Event.ABORT}
    asking.ask("show the board")
    assert asking.may() == {Event.ABORT, Event.APPROVE} and said[-1].strip().startswith("show the board, then")
    asking.ask(None)
    assert asking.may() == {Event.ABORT} and len(said) == 1


def test_a_pause_is_refused_during_a_calibration() -> None:
    answers, commands, asking = io.StringIO(), CommandQueue(), CalibrationPrompts(lambda _: None)
    terminal = TerminalOperator(commands, io.StringIO(), answers, may=asking.may)
    terminal.take("pause")
    assert "not possible now" in answers.getvalue() and "accepted" not in answers.getvalue()
    terminal.take("abort")
    assert answers.getvalue().endswith("end run: accepted\n")
