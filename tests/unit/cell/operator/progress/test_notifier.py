"""Messages of a run reach the terminal and the page."""

from __future__ import annotations

import io

import pytest

from foldcell.cell.operator.console.run_status import RunStatus
from foldcell.cell.operator.progress.lines import Notifier, ProgressLines
from tests.builders.records import run_status


def notifier(
    page: RunStatus | None = None, quiet: bool = False, typed: bool = True
) -> tuple[Notifier, io.StringIO]:
    stream = io.StringIO()
    return Notifier(ProgressLines(None if quiet else stream), page or run_status(), quiet, typed), stream


def test_terminal_and_page_get_the_same_messages() -> None:
    page = run_status()
    told, stream = notifier(page)
    told.note("the library is read")
    told.computing(3, 20, "simulations")
    shown = page.snapshot()
    assert "the library is read" in stream.getvalue()
    assert shown["note"] == "the library is read" and shown["progress"]["done"] == 3


@pytest.mark.parametrize(("typed", "keys"), [(True, " (a, Enter)"), (False, "")])
def test_questions_name_the_key_if_a_terminal_is_attended(typed: bool, keys: str) -> None:
    told, stream = notifier(typed=typed)
    told.ask("lay the garment")
    assert stream.getvalue().strip().endswith(f"lay the garment, then approve{keys}")
    before = stream.getvalue()
    told.ask(None)
    assert stream.getvalue() == before, "without a terminal no key is named"


def test_a_quiet_run_still_asks_questions(capsys: pytest.CaptureFixture[str]) -> None:
    """Standard output is reserved for the result."""
    page = run_status()
    told, stream = notifier(page, quiet=True)
    told.ask("lay the garment")
    out, err = capsys.readouterr()
    assert (out, stream.getvalue()) == ("", "") and err == "lay the garment, then approve (a, Enter)\n"
    assert "lay the garment" in page.snapshot()["question"]["text"]
    told.ask(None)
    assert page.snapshot()["question"] is None
