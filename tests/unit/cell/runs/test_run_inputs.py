"""Input files of a run are saved with it and used for its replay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from foldcell.cell.config.calibration_file import table_text, tactile_text
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.trajectory_library.library_file import (
    add_entry,
    load_library,
    shipped_library_path,
    user_library_path,
)
from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.runs.request_file import keep_request, keep_run_inputs, restored_request
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.baxter.robot import load_model
from tests.fakes import FakeCell
from tests.runs import fold_request


def kept(tmp_path: Path, request: FoldRequest) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    keep_request(folder, request)
    keep_run_inputs(folder, request)
    return folder


def restored(tmp_path: Path, folder: Path) -> FoldRequest:
    logs = tmp_path / "scratch"
    logs.mkdir()
    return restored_request(folder, logs)


def test_replay_uses_the_user_library_of_the_run(tmp_path: Path) -> None:
    """The library had one entry at the time of the run. Another entry was added later."""
    request = fold_request(tmp_path)
    shipped = load_library().library.entries
    add_entry(request.logs, replace(shipped[0], garment="mine"))
    folder = kept(tmp_path, request)
    add_entry(request.logs, replace(shipped[1], garment="later"))
    again = restored(tmp_path, folder)
    assert again.logs != request.logs and again.logs != folder
    garments = [entry.garment for entry in load_library(again.logs).library.entries]
    assert "mine" in garments and "later" not in garments
    assert len(garments) == len(load_library().library.entries) + 1


def test_a_replay_does_not_change_the_user_library(tmp_path: Path) -> None:
    request = fold_request(tmp_path)
    folder = kept(tmp_path, request)
    before = sorted(folder.iterdir())
    again = restored(tmp_path, folder)
    add_entry(again.logs, load_library().library.entries[0])
    assert not user_library_path(request.logs).exists() and sorted(folder.iterdir()) == before


def calibrated(tmp_path: Path) -> FoldRequest:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "table.yaml").write_text(table_text(-0.123))
    (tmp_path / "own" / "fingers.yaml").write_text(tactile_text({"contact_force": 0.7, "held_force": 1.3}))
    return fold_request(
        tmp_path, {"table": {"calibration": "own/table.yaml"}, "grasp": {"calibration": "own/fingers.yaml"}}
    )


@pytest.mark.parametrize("since", ["measured anew", "gone"])
def test_replay_uses_the_calibrations_of_the_run(tmp_path: Path, since: str) -> None:
    request = calibrated(tmp_path)
    folder = kept(tmp_path, request)
    for path in (tmp_path / "own").iterdir():
        path.unlink()
    if since == "measured anew":
        (tmp_path / "own" / "table.yaml").write_text(table_text(-0.150))
        (tmp_path / "own" / "fingers.yaml").write_text(tactile_text({"contact_force": 2.0, "held_force": 3.0}))
    settings = restored(tmp_path, folder).settings
    assert settings.table.height == -0.123
    grasp = settings.grasp.calibrated()
    assert (grasp.contact_force, grasp.held_force) == (0.7, 1.3)


def test_restored_settings_without_calibrations_are_equal(tmp_path: Path) -> None:
    request = fold_request(tmp_path, approve=True)
    again = restored(tmp_path, kept(tmp_path, request))
    assert again.settings.fingerprint() == request.settings.fingerprint()
    assert again.approve and (again.record, again.record_truth, again.terminal, again.quiet) == (False,) * 3 + (
        True,
    )
    assert not (tmp_path / "run" / "calibrations").exists()


def test_a_cell_can_be_assembled_from_the_run_inputs(tmp_path: Path) -> None:
    request = restored(tmp_path, kept(tmp_path, calibrated(tmp_path)))
    cell = assemble(
        request, load_model(), FakeCell().ports(), Recorder.silent(), CommandQueue(), None,  # type: ignore[arg-type]
        lambda text: None, lambda done, total, remark: None,
    )  # fmt: skip
    assert cell.table.height == -0.123 and cell.expected is not None
    assert cell.expected.name == load_garment("small_towel", load_settings().surface).name
    assert len(cell.library().entries) == len(load_library().library.entries)


def test_an_unreadable_library_counts_as_empty(tmp_path: Path) -> None:
    """This is also so in the run itself."""
    request = fold_request(tmp_path)
    user_library_path(request.logs).mkdir()
    assert not user_library_path(kept(tmp_path, request)).exists()


def test_the_shipped_library_is_not_saved_with_the_run(tmp_path: Path) -> None:
    folder = kept(tmp_path, fold_request(tmp_path))
    assert not user_library_path(folder).exists() and shipped_library_path().exists()
