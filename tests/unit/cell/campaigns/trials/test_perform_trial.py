"""A run of a campaign: finished once, never repeated, its recordings kept or not."""

from __future__ import annotations

import json
import pickle
import threading
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.campaigns.trials.campaign import Keep, TrialRequest
from foldcell.cell.campaigns.trials.perform_trial import perform_trial
from foldcell.cell.campaigns.trials.store import CampaignFolder, is_campaign
from foldcell.cell.campaigns.trials.trial import TRIAL, Trial, read_trial
from foldcell.cell.support.process.signals import Terminated
from foldcell.robots.errors import ConfigurationError, DriverError, FailureKind, StorageError
from tests.builders.campaigns import record, request, trials_campaign


def recorded(passed: bool) -> Any:
    def fold(request: TrialRequest, folder: Path) -> Trial:
        run = folder / "run"
        (run / "frames").mkdir(parents=True)
        for name in ("run.rrd", "frames/a.npz", "report.html", "result.json"):
            (run / name).write_text("x")
        return Trial(request, record(passed=passed))

    return fold


def test_a_finished_run_is_not_repeated(tmp_path: Path) -> None:
    calls = []

    def fold(request: TrialRequest, folder: Path) -> Trial:
        calls.append(request.seed)
        return Trial(request, record())

    first = perform_trial(request(), tmp_path, "all", fold)
    assert perform_trial(request(), tmp_path, "all", fold) == first and calls == [1]


def test_the_result_of_another_request_is_not_taken(tmp_path: Path) -> None:
    perform_trial(request(1), tmp_path, "all", lambda r, f: Trial(r, record()))
    assert read_trial(tmp_path, request(2)) is None


def test_a_run_has_the_library_and_the_heights_with_which_its_campaign_began(tmp_path: Path) -> None:
    logs, files = tmp_path / "logs", {"library.json": "arcs", "ideal_heights.json": "heights"}
    logs.mkdir()
    for name, text in files.items():
        (logs / name).write_text(text)
    (tmp_path / "campaign").mkdir()
    campaign = CampaignFolder.create(tmp_path / "campaign", trials_campaign([1]), logs)
    for name in files:
        (logs / name).write_text("of another day")

    def fold(request: TrialRequest, folder: Path) -> Trial:
        assert {name: (folder / name).read_text() for name in files} == files
        return Trial(request, record())

    assert perform_trial(request(), campaign.folder(request()), "all", fold).error == ""
    (campaign.path / "ideal_heights.json").write_text("other heights")
    with pytest.raises(ConfigurationError, match="library"):
        campaign.check_program()


@pytest.mark.parametrize("name", ["library.json", "ideal_heights.json"])
def test_a_campaign_does_not_begin_without_a_library_that_is_there(tmp_path: Path, name: str) -> None:
    """All its runs would use the shipped trajectories, and nobody would notice."""
    logs = tmp_path / "logs"
    (logs / name).mkdir(parents=True)
    (tmp_path / "campaign").mkdir()
    with pytest.raises(StorageError, match=f"{name} cannot be read"):
        CampaignFolder.create(tmp_path / "campaign", trials_campaign([1]), logs)
    assert not is_campaign(tmp_path / "campaign")


@pytest.mark.parametrize("content", ["", "{", "[]", '{"request": "other"}', '{"figures": null}'])
def test_a_damaged_result_counts_as_not_finished(content: str, tmp_path: Path) -> None:
    (tmp_path / TRIAL).write_text(content)
    assert read_trial(tmp_path, request()) is None


def test_the_remains_of_a_run_that_was_cut_off_are_removed(tmp_path: Path) -> None:
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "run.rrd").write_text("x")
    (tmp_path / "journal.db").write_text("x")

    def fold(request: TrialRequest, folder: Path) -> Trial:
        assert sorted(p.name for p in folder.iterdir()) == ["trial.lock"]
        return Trial(request, record())

    assert perform_trial(request(), tmp_path, "all", fold).error == ""


@pytest.mark.parametrize(
    ("keep", "passed", "kept"),
    [("all", True, True), ("failures", True, False), ("failures", False, True), ("none", False, False)],
)
def test_recordings_are_kept_as_asked_and_reports_always(
    keep: Keep, passed: bool, kept: bool, tmp_path: Path
) -> None:
    perform_trial(request(), tmp_path, keep, recorded(passed))
    run = tmp_path / "run"
    assert (run / "run.rrd").exists() == (run / "frames").exists() == kept
    assert (run / "report.html").exists() and (run / "result.json").exists()


def test_an_error_of_the_run_is_a_result_that_is_not_repeated(tmp_path: Path) -> None:
    def fold(request: TrialRequest, folder: Path) -> Trial:
        raise ConfigurationError("no such garment", "name another one")

    done = perform_trial(request(), tmp_path, "all", fold)
    assert done.record is None and "no such garment" in done.error
    assert perform_trial(request(), tmp_path, "all", recorded(True)) == done


@pytest.mark.parametrize("error", [StorageError("full", "free some"), OSError(28, "No space left on device")])
def test_a_full_disk_is_no_result_of_the_run(error: Exception, tmp_path: Path) -> None:
    def fold(request: TrialRequest, folder: Path) -> Trial:
        raise error

    with pytest.raises(type(error)):
        perform_trial(request(), tmp_path, "all", fold)
    assert read_trial(tmp_path, request()) is None


def test_the_same_run_in_two_processes_is_performed_once(tmp_path: Path) -> None:
    calls, results = [], []
    begun, go_on = threading.Event(), threading.Event()

    def fold(request: TrialRequest, folder: Path) -> Trial:
        calls.append(1)
        begun.set()
        go_on.wait(10.0)
        return Trial(request, record())

    threads = [
        threading.Thread(target=lambda: results.append(perform_trial(request(), tmp_path, "all", fold)))
        for _ in range(2)
    ]
    threads[0].start()
    begun.wait(10.0)
    threads[1].start()
    go_on.set()
    for thread in threads:
        thread.join()
    assert len(calls) == 1 and results[0] == results[1]
    assert read_trial(tmp_path, request()) == results[0] == Trial(request(), record())


def other_python(tmp_path: Path, script: str) -> TrialRequest:
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)
    return TrialRequest("old", "towel", 7, "sim", "xpbd", {"pressing": {"max_attempts": 0}}, (), str(python))


def test_another_version_is_called_by_its_command_line(tmp_path: Path) -> None:
    (tmp_path / "answer").write_text(json.dumps(record().as_json()))
    request = other_python(tmp_path, 'echo "$@" > "$0.line"; echo progress; cat "$(dirname "$0")/answer"')
    assert perform_trial(request, tmp_path / "run", "all").record == record()
    line = (tmp_path / "python.line").read_text()
    assert "fold towel --seed 7" in line and f"--logs {tmp_path / 'run'} --json" in line
    settings = (tmp_path / "run" / "cell.yaml").read_text()
    assert "max_attempts: 0" in settings and "schema: 1" in settings


def test_the_last_line_of_another_version_that_fails_is_reported(tmp_path: Path) -> None:
    request = other_python(tmp_path, "echo 'foldcell: unknown key' >&2; exit 64")
    done = perform_trial(request, tmp_path / "run", "all")
    assert done.record is None and "64: foldcell: unknown key" in done.error


def test_a_run_that_a_signal_ended_is_not_finished(tmp_path: Path) -> None:
    """A worker that is told to end stops its run, and the stopped run has a record."""
    with pytest.raises(BrokenExecutor):
        perform_trial(request(), tmp_path, "all", lambda r, f: Trial(r, record("not_folded", signal=15)))

    def ended(request: TrialRequest, folder: Path) -> Trial:
        raise Terminated(15)

    with pytest.raises(BrokenExecutor, match="SIGTERM"):
        perform_trial(request(), tmp_path, "all", ended)
    assert read_trial(tmp_path, request()) is None


def test_a_run_that_could_not_be_recorded_is_not_finished(tmp_path: Path) -> None:
    unrecorded = record("fault", failure=FailureKind.UNRECORDED, what="the disk is full")
    with pytest.raises(StorageError, match="the disk is full"):
        perform_trial(request(), tmp_path, "all", lambda r, f: Trial(r, unrecorded))
    assert read_trial(tmp_path, request()) is None


def test_a_run_whose_robot_does_not_start_is_not_finished(tmp_path: Path) -> None:
    def fold(request: TrialRequest, folder: Path) -> Trial:
        raise DriverError(FailureKind.HARDWARE_FAULT, "the emulated robot does not respond", "see its output")

    with pytest.raises(DriverError, match="does not respond") as raised:
        perform_trial(request(), tmp_path, "all", fold)
    assert read_trial(tmp_path, request()) is None
    copy = pickle.loads(pickle.dumps(raised.value))  # the worker process sends it
    assert copy.failure() == raised.value.failure() and str(copy) == str(raised.value)
