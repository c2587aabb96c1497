"""The owner of a cell, and the owner's journal."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.journal.journal import Journal
from foldcell.cell.runs.ownership import VERSIONED, begun_run, owned_cell
from foldcell.cell.support.files.paths import journal_path
from foldcell.robots.errors import ConfigurationError
from tests.fakes import FakeCell


def statuses(logs: Path) -> list[str]:
    with Journal.open(journal_path(logs), readonly=True) as kept:
        return [run.status for run in kept.runs()]


def test_a_cell_has_one_owner_that_releases_it(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    cell = FakeCell()
    with owned_cell(tmp_path) as (interrupts, _):
        with interrupts.stop(cell.ports(), asked=False):
            assert signal.getsignal(signal.SIGINT) is not before
        with pytest.raises(ConfigurationError, match="in use"), owned_cell(tmp_path):
            pass
    assert signal.getsignal(signal.SIGINT) is before
    with owned_cell(tmp_path):  # the cell is free again
        pass


def test_a_run_without_an_end_is_shown_as_interrupted(tmp_path: Path) -> None:
    settings = load_settings(None)
    with owned_cell(tmp_path) as (_, journal):
        with begun_run(journal, "small_towel", 7, "sim", settings) as run:
            assert set(journal.run(run.id).versions) == set(VERSIONED)
            run.end("folded")
        with pytest.raises(RuntimeError), begun_run(journal, "small_towel", 8, "sim", settings) as run:
            raise RuntimeError("before its end")
        with pytest.raises(RuntimeError), begun_run(journal, "small_towel", 9, "sim", settings) as run:
            run.end("not_folded")
            raise RuntimeError("after its end")
    assert sorted(statuses(tmp_path)) == ["folded", "interrupted", "not_folded"]


def test_a_run_whose_cell_could_not_be_opened_names_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An error before the run begins is a refusal and not an interruption."""
    settings = load_settings(None)
    silent = ConfigurationError("no ROS master answers", "switch the robot on")
    with owned_cell(tmp_path) as (_, journal):
        with pytest.raises(ConfigurationError), begun_run(journal, "small_towel", 1, "ros", settings) as run:
            run.intent(0.0, "preparing", "prepare")
            raise silent
        with pytest.raises(ConfigurationError), begun_run(journal, "small_towel", 2, "ros", settings):
            raise silent
    assert statuses(tmp_path) == ["interrupted", "not_begun"]
    assert main(["runs", "--logs", str(tmp_path)]) == 0
    assert capsys.readouterr().out.rstrip().endswith("not_begun: no ROS master answers")
    assert main(["report", "last", "--logs", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "the run did not begin: no ROS master answers" in told and "switch the robot on" in told
    assert "killed" not in told
