"""A campaign with a person: every verdict is kept, whatever happens, and no run is judged or performed twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.paper_table import page as paper_page
from foldcell.cell.campaigns.page.campaign_page import campaign_page
from foldcell.cell.campaigns.results import CampaignResults
from foldcell.cell.campaigns.trials.attended import attended_trials
from foldcell.cell.campaigns.trials.campaign import Campaign, TrialRequest, read_campaign
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import TRIAL, Trial, read_trial
from foldcell.cell.commands.main import main
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.record.judgement import Judgement
from foldcell.cell.record.run_record import Recognised, RunRecord
from foldcell.cell.runs.fold_run import Attendance
from foldcell.cell.support.process.signals import Terminated
from foldcell.robots.errors import ConfigurationError, DriverError, FailureKind, StorageError
from tests.builders.campaigns import record, request, trials_campaign

GOOD, BAD = Judgement(True), Judgement(False, "a sleeve lies open")
SEEN = Recognised("towel", 0.9)


def campaign(path: Path, seeds: int = 2, driver: str = "ros") -> CampaignFolder:
    requests = tuple(
        TrialRequest("shipped", garment, seed, driver, "xpbd", {}, attended=True)
        for seed in range(1, seeds + 1)
        for garment in ("towel", "shirt")
    )
    return CampaignFolder.create(path, Campaign("", "all", requests, {"shipped": ""}), path / "logs")


class Person:
    """Performs runs that end at once. verdicts: of the runs in order; an exception is raised in place of the
    verdict. record: of every run."""

    def __init__(self, *verdicts: Judgement | BaseException | None, record: RunRecord | None = None) -> None:
        self.verdicts, self.record = list(verdicts), record or record_of_robot()
        self.laid: list[str] = []
        self.asked_later: list[str] = []
        self.stored: list[Trial | None] = []

    def perform(self, request: TrialRequest, folder: Path, attendance: Attendance) -> RunRecord:
        self.laid.append(attendance.begin)

        def ask() -> Judgement | None:
            self.stored.append(read_trial(folder, request))
            return self.next()

        attendance.recorded(self.record)
        attendance.judge(ask)
        return self.record

    def later(self, about: str) -> Judgement | None:
        self.asked_later.append(about)
        return self.next()

    def next(self) -> Judgement | None:
        verdict = self.verdicts.pop(0)
        if isinstance(verdict, BaseException):
            raise verdict
        return verdict

    def attend(self, folder: CampaignFolder) -> list[Trial]:
        return list(attended_trials(folder, self.perform, self.later))


def record_of_robot(result: Any = "folded", **values: Any) -> RunRecord:
    return record(result, passed=None, driver="ros", simulated=False, world=None, recognised=SEEN, **values)


def test_each_garment_is_asked_for_in_turn_and_judged(tmp_path: Path) -> None:
    folder, person = campaign(tmp_path), Person(GOOD, BAD, GOOD, GOOD)
    trials = person.attend(folder)
    assert [line.partition(":")[0] for line in person.laid] == [
        "run 1 of 4, towel", "run 2 of 4, shirt", "run 3 of 4, towel", "run 4 of 4, shirt"
    ]  # fmt: skip
    assert folder.finished() == trials and [t.judgement for t in trials] == [GOOD, BAD, GOOD, GOOD]
    assert [t.success for t in trials] == [True, False, True, True]
    assert (trials[1].verdict, trials[1].cause) == ("false claim", "judged: a sleeve lies open")
    assert all(stored and stored.unjudged for stored in person.stored), "each run is on disk before the question"


def test_a_run_that_waits_for_its_verdict_is_judged_the_next_day_and_not_performed_again(tmp_path: Path) -> None:
    folder, person = campaign(tmp_path, 1), Person(GOOD, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        person.attend(folder)
    assert [t.judgement for t in folder.finished()] == [GOOD]
    person.verdicts = [BAD]
    (judged,) = person.attend(CampaignFolder.open(tmp_path))
    assert judged.judgement == BAD and len(person.laid) == 2 and person.asked_later == [
        "shirt, run 1, performed before"
    ]  # fmt: skip
    assert person.attend(folder) == [], "the campaign is complete"


def test_a_run_that_nobody_can_judge_is_performed_again(tmp_path: Path) -> None:
    folder, person = campaign(tmp_path, 1), Person(None)
    assert person.attend(folder) == [] and len(person.laid) == 1
    person.verdicts = [Judgement(None), GOOD, GOOD]
    assert [t.judgement for t in person.attend(folder)] == [GOOD, GOOD] and len(person.laid) == 3


def test_the_day_ends_when_the_person_does_not_lay_the_garment(tmp_path: Path) -> None:
    aborted = record_of_robot("not_folded", failure=FailureKind.ABORTED)
    person = Person(record=RunRecord(**{**vars(aborted), "recognised": None}))
    assert person.attend(campaign(tmp_path, 1)) == [] and len(person.laid) == 1

    def refused(request: TrialRequest, folder: Path, attendance: Attendance) -> RunRecord:
        raise DriverError(FailureKind.ABORTED, "the operator ended the run")

    assert list(attended_trials(CampaignFolder.open(tmp_path), refused, person.later)) == []
    assert not list(tmp_path.rglob(TRIAL))


def test_a_run_that_the_person_ends_later_is_a_result(tmp_path: Path) -> None:
    aborted = record_of_robot("not_folded", failure=FailureKind.ABORTED)
    trials = Person(BAD, BAD, record=aborted).attend(campaign(tmp_path, 1))
    assert [(t.success, t.cause) for t in trials] == [(False, "aborted")] * 2


@pytest.mark.parametrize(
    ("run", "error"),
    [
        (record_of_robot("not_folded", signal=15), Terminated),
        (record_of_robot("fault", failure=FailureKind.UNRECORDED), StorageError),
    ],
)
def test_a_run_that_was_cut_off_is_no_result(run: RunRecord, error: type[Exception], tmp_path: Path) -> None:
    folder = campaign(tmp_path, 1)
    with pytest.raises(error):
        Person(record=run).attend(folder)
    assert not list(tmp_path.rglob(TRIAL)) and len(folder.missing(folder.finished())) == 2


def test_the_person_judges_and_not_the_score() -> None:
    """An emulated run has a simulated truth, which is another verdict than the person's."""
    attended = TrialRequest("shipped", "towel", 1, "emulator", "xpbd", {}, attended=True)
    assert not Trial(attended, record(passed=True), judgement=BAD).success
    assert Trial(attended, record(passed=False), judgement=GOOD).success
    assert Trial(request(), record(passed=True)).success


@pytest.mark.parametrize(
    ("driver", "label"),
    [("ros", "robot, judged by a person"), ("emulator", "simulated (emulator), judged by a person")],
)
def test_page_and_table_name_the_cell_and_who_judged(driver: str, label: str, tmp_path: Path) -> None:
    requests = tuple(
        TrialRequest("shipped", "medium_towel", seed, driver, "xpbd", {}, attended=True) for seed in (1, 2)
    )
    folder = CampaignFolder.create(tmp_path, Campaign("", "all", requests, {"shipped": ""}), tmp_path / "logs")
    trials = Person(GOOD, BAD).attend(folder)
    results = CampaignResults.of(folder.campaign, trials)
    text, table = campaign_page(folder, results), paper_page(folder, trials)
    assert f'<span class="tag">{label}</span>' in text and "judged: a sleeve lies open" in text
    assert "scorer" not in text and "the person at the cell judged" in text
    assert (
        f"**{label}**" in table
        and "scorer" not in table
        and "| medium towel | 2 | 2 | 10 of 10 | 1 of 2 |" in table
    )
    assert "a sleeve lies open" in table and "Claims: 1 true, 1 false" in table
    values = results.as_json()
    assert values["label"] == label and values["runs"][1]["judgement"] == {"passed": False, "why": BAD.why}


def test_campaigns_judged_by_a_person_are_not_compared_with_scored_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    campaign(tmp_path / "a")
    CampaignFolder.create(tmp_path / "b", trials_campaign([1]), tmp_path / "logs")
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 64
    assert "a person judged a" in capsys.readouterr().err


@pytest.mark.parametrize("variant", ["do: [{fault: {kind: missed_grasp}}]", "python: /bin/sh"])
def test_a_person_attends_no_scripts_and_no_other_version(variant: str, tmp_path: Path) -> None:
    path = tmp_path / "campaign.yaml"
    path.write_text(f"garments: [small_towel]\nseeds: [1]\nvariants: {{own: {{{variant}}}}}\n")
    read_campaign(path, load_settings())
    with pytest.raises(ConfigurationError, match="scripted actions or another version"):
        read_campaign(path, load_settings(), "ros", attended=True)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--attended --hours 1", "without a person"),
        ("--driver ros --faults", "without a person"),
        ("--attended --workers 2", "one run at a time"),
    ],
)
def test_options_that_need_no_person_are_refused(
    line: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trials", "--garments", "small_towel", "--logs", str(tmp_path), *line.split()]) == 64
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("trials-*")), "no campaign that never began is left"
