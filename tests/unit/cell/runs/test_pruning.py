"""Removing large files of old runs: which runs are pruned and which are kept."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from foldcell.cell.commands.main import main
from foldcell.cell.journal.journal import Journal, RunJournal
from foldcell.cell.runs.pruning import RECORDINGS, prunable_runs, prune
from foldcell.robots.errors import StorageError

LIGHT = ("report.html", "result.json", "cell.yaml")


class Logs:
    """Runs in a logs folder and in a campaign's folder. Each begins one second after the previous one."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.clock = folder, 1000.0
        self.journals: dict[Path, Journal] = {}

    def run(self, result: str | None, campaign: str = "") -> RunJournal:
        self.clock += 1.0
        place = self.folder / campaign
        place.mkdir(parents=True, exist_ok=True)
        journal = self.journals.setdefault(place, Journal.open(place / "journal.db"))
        run = journal.begin_run(garment="towel", seed=1, driver="sim", wall_clock=lambda: self.clock)
        for name in ("run.rrd", "run.transcript", "world.npz", *LIGHT):
            (run.directory / name).write_bytes(b"x" * 1000)
        for name in ("frames", "checkpoint", "began_with"):
            (run.directory / name).mkdir()
            (run.directory / name / ("context" if name == "checkpoint" else "0.png")).write_bytes(b"x" * 500)
        if result == "cut off":
            run.abandon()
        elif result:
            run.end(result)
        return run


@pytest.fixture
def logs(tmp_path: Path) -> Iterator[Logs]:
    made = Logs(tmp_path)
    yield made
    for journal in made.journals.values():
        journal.close()


def chosen(logs: Logs, keep: int, unfinished: bool = False) -> list[str]:
    return [heavy.run.id for heavy in prunable_runs(logs.folder, keep, unfinished)]


def test_the_newest_runs_are_kept(logs: Logs) -> None:
    first = logs.run("folded")
    second = logs.run("folded", "trials-1/towel-seed7")
    third = logs.run("folded", "trials-1/no_pressing/towel-seed7")
    logs.run("folded")
    assert chosen(logs, 1) == [first.id, second.id, third.id]
    assert chosen(logs, 2) == [first.id, second.id]
    assert chosen(logs, 4) == chosen(logs, 99) == []


def test_the_newest_runs_are_kept_after_the_clock_was_set_back(logs: Logs) -> None:
    """Runs of one journal have its order. Times order only runs of different journals."""
    logs.clock = 5000.0
    first, second = logs.run("folded"), logs.run("folded")
    logs.clock = 1000.0
    logs.run("folded")
    assert chosen(logs, 1) == [first.id, second.id]


def test_running_and_resumable_runs_are_kept(logs: Logs) -> None:
    going, cut_off, refused, folded = map(logs.run, (None, "cut off", "not_folded", "folded"))
    assert chosen(logs, 0) == [folded.id]
    assert chosen(logs, 0, unfinished=True) == [cut_off.id, refused.id, folded.id]
    going.abandon()


def test_pruning_removes_large_files_once(logs: Logs) -> None:
    run = logs.run("folded")
    (heavy,) = prunable_runs(logs.folder, 0)
    assert heavy.bytes == 4500
    prune(heavy)
    assert sorted(p.name for p in run.directory.iterdir()) == sorted(LIGHT)
    assert not any((run.directory / name).exists() for name in RECORDINGS)
    assert chosen(logs, 0) == []


def test_only_runs_with_a_checkpoint_are_checked_for_resuming(logs: Logs, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each check reads the whole journal, so checking hundreds of finished runs would take minutes."""
    asked: list[str] = []
    monkeypatch.setattr("foldcell.cell.runs.pruning.resumable", lambda journal, name: bool(asked.append(name)))
    cut_off, folded, tidied = logs.run("cut off"), logs.run("folded"), logs.run("cut off")
    shutil.rmtree(folded.directory / "checkpoint")
    for name in RECORDINGS:
        path = tidied.directory / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert chosen(logs, 0) == [cut_off.id, folded.id] and asked == [cut_off.id]


def test_a_file_that_cannot_be_removed_is_a_storage_error(logs: Logs, monkeypatch: pytest.MonkeyPatch) -> None:
    logs.run("folded")
    (heavy,) = prunable_runs(logs.folder, 0)

    def refuse(self: Path) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(StorageError, match=r"run\.rrd"):
        prune(heavy)


def test_pruning_needs_a_confirmation(logs: Logs, capsys: pytest.CaptureFixture[str]) -> None:
    run = logs.run("folded")
    command = ["tidy", "--logs", str(logs.folder), "--keep", "1"]
    assert main(command) == 0 and "nothing to remove" in capsys.readouterr().out
    logs.run("folded")
    assert main(command) == 0
    told = capsys.readouterr().out
    assert run.id in told and "--yes" in told and (run.directory / "run.rrd").is_file()
    assert main([*command, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["bytes"] == 4500 and not figures["removed"] and (run.directory / "run.rrd").is_file()
    assert main([*command, "--yes"]) == 0
    assert "freed" in capsys.readouterr().out and not (run.directory / "run.rrd").is_file()


def test_an_empty_folder_has_nothing_to_remove(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tidy", "--logs", str(tmp_path)]) == 0
    assert "nothing to remove" in capsys.readouterr().out
