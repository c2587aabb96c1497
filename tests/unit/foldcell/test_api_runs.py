"""`foldcell.fold` refuses wrong arguments, and `foldcell.load_run` reads the journal of a run. A whole run is read
in tests/cell/test_loaded_run.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import foldcell
from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.run_record import FoldRecord
from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.paths import journal_path
from tests.builders.records import run_record


def begun(logs: Path) -> Any:
    """A run with a few entries that has not ended. Returns (journal, run)."""
    journal = Journal.open(journal_path(logs))
    run = journal.begin_run(garment="small_towel", seed=4, driver="sim", versions={"foldcell": "0.1.0"})
    run.event(0.5, "idle", "started")
    look = run.intent(1.0, "observing", "look", {"step": 0, "attempt": 0})
    run.result(look, 3.5, {"event": "done"})
    grasp = run.intent(4.0, "grasping", "grasp", {"step": 0, "attempt": 1})
    run.result(grasp, 6.0, {"event": "failed", "kind": "missed_grasp", "what": "nothing between the pads"})
    run.intent(7.0, "grasping", "grasp", {"step": 1, "attempt": 0})
    return journal, run


@pytest.fixture
def ended(tmp_path: Path) -> Iterator[Path]:
    """The folder of a run that has ended."""
    journal, run = begun(tmp_path)
    folds = (FoldRecord("half", done=True), FoldRecord("quarter"))
    run.end("not_folded", run_record(result="not_folded", state=State.NOT_FOLDED, steps=folds).as_json())
    journal.close()
    yield run.directory


def test_load_run_accepts_folder_id_prefix_and_last(ended: Path) -> None:
    by_folder = foldcell.load_run(ended)
    for name in (ended.name, ended.name[:12], "last", str(ended)):
        assert foldcell.load_run(name, logs=ended.parent).id == by_folder.id == ended.name
    assert by_folder.folder == ended


def test_load_run_returns_figures_events_and_effects(ended: Path) -> None:
    run = foldcell.load_run(ended)
    assert (run.status, run.garment, run.seed, run.driver) == ("not_folded", "small_towel", 4, "sim")
    assert run.versions == {"foldcell": "0.1.0"}
    assert run.ended is not None and run.started <= run.ended
    assert [fold.name for fold in run.folds] == ["half", "quarter"]
    assert [entry.sequence for entry in run.entries] == [1, 2, 3, 4, 5, 6]
    assert run.entries[0].name == "started" and run.entries[0].cell_time == 0.5
    look, missed, open_ = run.effects
    assert (look.name, look.fold, look.begun_s, look.ended_s) == ("look", 0, 1.0, 3.5)
    assert (missed.attempt, missed.failure, missed.event) == (1, "missed_grasp", "failed")
    assert (open_.fold, open_.ended_s, open_.event) == (1, None, None)
    assert run.set_points() is None


def test_an_interrupted_run_has_no_result(tmp_path: Path) -> None:
    journal, run = begun(tmp_path)
    run.abandon()
    journal.close()
    read = foldcell.load_run("last", logs=tmp_path)
    assert (read.status, read.ended, read.record, read.folds) == ("interrupted", None, None, ())
    assert len(read.effects) == 3


def test_load_run_refuses_a_run_that_has_not_ended(tmp_path: Path) -> None:
    journal, run = begun(tmp_path)
    with pytest.raises(foldcell.ConfigurationError, match="has not ended"):
        foldcell.load_run("last", logs=tmp_path)
    run.abandon()
    journal.close()


def test_load_run_refuses_an_unknown_run(ended: Path, tmp_path: Path) -> None:
    with pytest.raises(foldcell.ConfigurationError, match="no run '2001'"):
        foldcell.load_run("2001", logs=ended.parent)
    with pytest.raises(foldcell.StorageError):
        foldcell.load_run("last", logs=tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"garment": "sock"}, "sock"),
        ({"garment": "small_towel", "seed": -1}, "-1 is no seed"),
        ({"garment": "small_towel", "driver": "tractor"}, "no driver 'tractor'"),
        ({"garment": "small_towel", "settings": "nowhere.yaml"}, "nowhere.yaml"),
    ],
)
def test_fold_refuses_wrong_arguments_before_a_run_begins(
    arguments: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(foldcell.ConfigurationError, match=words):
        foldcell.fold(logs=tmp_path, **arguments)
    assert not journal_path(tmp_path).exists()
