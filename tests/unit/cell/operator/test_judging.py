"""The verdict of a person: typed lines and messages of the page."""

from __future__ import annotations

import io
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.operator.console.messages import JudgeMessage, StopMessage, read_message
from foldcell.cell.operator.judging import ask_judgement
from foldcell.cell.record.judgement import Judgement, judgement_of
from tests.builders.records import run_record, run_status


@pytest.mark.parametrize(
    ("line", "judgement"),
    [
        ("y", Judgement(True)),
        ("YES  very   flat", Judgement(True, "very flat")),
        ("n a sleeve\tlies open", Judgement(False, "a sleeve lies open")),
        ("No It's a heap", Judgement(False, "It's a heap")),
        ("n", None),  # why not?
        ("u", None),
        ("a", None),
        ("", None),
    ],
)
def test_a_typed_line_is_a_verdict(line: str, judgement: Judgement | None) -> None:
    assert judgement_of(line) == judgement


def test_nobody_may_have_seen_the_garment() -> None:
    assert judgement_of("u", unseen=True) == Judgement(None)


@given(st.text())
def test_any_other_line_is_no_verdict(line: str) -> None:
    judgement = judgement_of(line)
    assert judgement is None or (judgement.passed or judgement.why)


def test_the_question_is_repeated_until_there_is_a_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    typed = io.StringIO("a\nn\nN left Sleeve\n")
    assert ask_judgement("towel", typed) == Judgement(False, "left Sleeve"), "the reason keeps its letters"
    said = capsys.readouterr().err
    assert said.startswith("towel: y if") and "'a' is no verdict" in said and "'n' is no verdict" in said


def test_a_closed_terminal_ends_the_question() -> None:
    typed = io.StringIO()
    assert ask_judgement("towel", typed) is None
    assert ask_judgement("towel", typed) is None, "also a question that is asked later"


def test_an_end_of_the_run_ends_the_question() -> None:
    assert ask_judgement("towel", None, ended=lambda: True) is None


def test_the_page_takes_the_verdict_once_and_only_for_its_question() -> None:
    status, given_ = run_status(simulated=False), []
    status.finish(run_record(driver="ros", simulated=False))
    assert status.snapshot()["judging"] is None and not status.judged(0, Judgement(True))
    asking = threading.Thread(target=lambda: given_.append(ask_judgement("towel", None, status)), daemon=True)
    asking.start()
    while (number := status.snapshot()["judging"]) is None:
        asking.join(0.01)
    assert not status.judged(number - 1, Judgement(True)), "a verdict on an earlier garment is refused"
    assert status.judged(number, Judgement(False, "open"))
    asking.join(10.0)
    assert given_ == [Judgement(False, "open")]
    assert status.snapshot()["judging"] is None and not status.judged(number, Judgement(True))


@pytest.mark.parametrize(
    ("text", "valid"),
    [
        ('{"judge": {"passed": true}, "question": 3}', True),
        ('{"judge": {"passed": false, "why": "open"}, "question": 3}', True),
        ('{"judge": {"passed": false, "why": "  "}, "question": 3}', False),
        ('{"judge": {"passed": false}, "question": 3}', False),
        ('{"judge": {"passed": 1}, "question": 3}', False),
        ('{"judge": {"passed": true}}', False),
        ('{"judge": true, "question": 3}', False),
    ],
)
def test_a_verdict_of_the_page_has_a_reason_and_its_question(text: str, valid: bool) -> None:
    assert isinstance(read_message(text), JudgeMessage) == valid


def test_a_verdict_with_a_stop_is_a_stop() -> None:
    assert isinstance(read_message('{"judge": {"passed": true}, "question": 3, "stop": 0}'), StopMessage)
