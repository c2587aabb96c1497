"""`foldcell trials --faults`: exit codes, results, and continuing an interrupted campaign."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.campaigns.hil.director import Observations
from foldcell.cell.campaigns.hil.script import Action
from foldcell.cell.campaigns.trials import perform_trial
from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.commands.main import main
from foldcell.cell.record.run_record import RunResult
from foldcell.robots.errors import FailureKind
from tests.builders.campaigns import record, request


def ended(result: RunResult = "folded", missed: tuple[Action, ...] = (), **values: Any) -> Trial:
    """A run that parked."""
    return Trial(
        request(), record(result, **values), seen=Observations(states=(), failures=(), parked=True, missed=missed)
    )


FOLDED, ASKED = ended(), ended("not_folded", passed=None, failure=FailureKind.CAMERA_FAULT)
SLIP = Action.model_validate({"fault": {"kind": "slip"}})


class Runs:
    """Replaces the runs: `ends` has how a fault's run ends, all others fold."""

    def __init__(self) -> None:
        self.ends: dict[str, Trial] = {}
        self.requests: list[TrialRequest] = []

    def perform(self, request: TrialRequest, folder: Path) -> Trial:
        self.requests.append(request)
        return replace(self.ends.get(request.variant, FOLDED), request=request)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Runs:
    replaced = Runs()
    monkeypatch.setattr(perform_trial, "_this_version", replaced.perform)
    monkeypatch.setattr("foldcell.cell.campaigns.executors.worker_pool", ThreadPoolExecutor)
    monkeypatch.setenv("FOLDCELL_LOGS", str(tmp_path / "logs"))
    return replaced


def faults(*more: str) -> int:
    return main(["trials", "--faults", "--garments", "small_towel", "--n", "2", *more])


def test_all_ends_as_due_give_exit_code_0(runs: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    runs.ends = {"camera_silent_for_good": ASKED}
    assert faults("--only", "slip,camera_silent", "--json") == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {row["name"]: (row["due"], row["runs"]) for row in answer["faults"]} == {
        "camera_silent": (2, 2), "camera_silent_for_good": (2, 2), "slip": (2, 2),
    }  # fmt: skip
    folder = Path(answer["directory"])
    assert json.loads((folder / "faults.json").read_text())["totals"] == answer["totals"]
    assert (folder / "faults.html").is_file() and not (folder / "campaign.html").exists()


@pytest.mark.parametrize("end", [ASKED, ended(missed=(SLIP,)), ended(passed=False)])
def test_one_end_that_was_not_due_gives_exit_code_2(
    runs: Runs, end: Trial, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.ends = {"slip": end}
    assert faults("--only", "slip,camera_silent_for_good") == 2
    out = capsys.readouterr().out
    assert "slip" in out and ("NOT AS DUE" in out or "without the fault" in out)


def test_pairs_are_added_on_request(runs: Runs) -> None:
    assert faults("--only", "slip,missed_grasp", "--pairs") == 0
    assert {request.variant for request in runs.requests} == {
        "slip", "missed_grasp", "slip+missed_grasp", "missed_grasp+slip",
    }  # fmt: skip


def test_an_interrupted_campaign_is_continued_with_its_missing_runs_only(
    runs: Runs, capsys: pytest.CaptureFixture[str]
) -> None:
    assert faults("--only", "slip", "--json") == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    (Path(answer["directory"]) / "slip" / "small_towel-seed2" / "trial.json").unlink()
    runs.requests.clear()
    assert main(["trials", "--resume", answer["directory"], "--json"]) == 0
    assert [request.seed for request in runs.requests] == [2]
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["totals"] == answer["totals"]


def test_a_table_of_ones_own_is_performed_and_kept_with_the_campaign(runs: Runs, tmp_path: Path) -> None:
    table = tmp_path / "mine.yaml"
    table.write_text(
        "stages: {fold: {during: {folding: 2.0}}}\nfaults:\n  deep: {kind: sudden_drop, size: 0.1, place: world, "
        "stage: fold, end: [recovered, asked], why: it is deep}\n"
    )
    assert main(["trials", "--faults", str(table), "--garments", "small_towel", "--n", "1"]) == 0
    assert [request.variant for request in runs.requests] == ["deep"]
    (folder,) = (tmp_path / "logs").glob("faults-*")
    assert (folder / "fault_table.yaml").read_text() == table.read_text()


@pytest.mark.parametrize(
    "line",
    ["--pairs", "--only slip", "--faults --hours 1", "--faults none.yaml", "--faults --only slips",
     "--faults --garments sock"],
)  # fmt: skip
def test_contradicting_options_are_refused(line: str, runs: Runs, tmp_path: Path) -> None:
    assert main(["trials", *line.split()]) == 64
    assert runs.requests == [] and not list(tmp_path.rglob("*.json"))
