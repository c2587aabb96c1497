"""The runs of a table of faults, how their ends are judged, and the results."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.campaigns.faults.fault_table import DueEnd, read_fault_table
from foldcell.cell.campaigns.faults.fault_trials import chosen_faults, fault_campaign, faults_of
from foldcell.cell.campaigns.faults.judge import due_ends, judge
from foldcell.cell.campaigns.faults.results import FaultResults, Group
from foldcell.cell.campaigns.hil.director import Observations
from foldcell.cell.campaigns.hil.script import Action
from foldcell.cell.campaigns.page.fault_page import write_fault_results
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.campaigns.trials.campaign import Campaign, TrialRequest
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.record.run_record import FailureRecord
from foldcell.cell.simulation import TRAITS
from foldcell.cell.states.transition_table import State
from foldcell.robots.errors import ConfigurationError, FailureKind
from tests.builders.records import run_record, score_record

TABLE = read_fault_table()
LIMITS = {"iou": 0.9, "drift_m": 0.05, "height_m": 0.02}
GOOD = score_record(LIMITS, iou=0.95, drift_m=0.01, height_m=0.01)
ASKING = FailureRecord(FailureKind.CAMERA_FAULT, "the camera does not answer", "plug it in again")
MISSED = Action.model_validate({"fault": {"kind": "slip"}})


def campaign(*names: str, seeds: tuple[int, ...] = (1, 2), pairs: bool = False) -> Campaign:
    table = chosen_faults(TABLE, names) if names else TABLE
    return fault_campaign(table, ("small_towel", "medium_towel"), seeds, load_settings(), pairs=pairs)


def ended(
    variant: str,
    result: str = "folded",
    state: str | None = None,
    garment: str = "small_towel",
    seed: int = 1,
    seen: dict[str, Any] | None = None,
    **values: Any,
) -> Trial:
    """A run with a good score (if folded) or a question (if not), apart from `values`. seen: observations that are
    not as in a run that parked."""
    folded = result == "folded"
    end = {"score": GOOD, "failure": None} if folded else {"score": None, "failure": ASKING}
    observed = {"states": (), "failures": (), "parked": True, "missed": (), **(seen or {})}
    record = run_record(result=result, state=State(state or result), **{**end, **values})
    return Trial(TrialRequest(variant, garment, seed, "sim", "xpbd", {}), record, seen=Observations(**observed))


# the runs


def test_every_fault_has_a_run_with_every_garment_and_seed() -> None:
    requests = campaign().requests
    assert len({request.key for request in requests}) == len(requests) == 2 * 2 * len(TABLE.faults)
    assert len({request.folder for request in requests}) == len(requests)
    assert [request.seed for request in requests] == sorted(request.seed for request in requests)


def test_moment_side_and_direction_are_drawn_by_garment_and_seed() -> None:
    requests = campaign("slip", seeds=tuple(range(12))).requests
    actions = [Action.model_validate(request.actions[0]) for request in requests]
    again = campaign("slip", seeds=tuple(range(12))).requests
    assert [r.actions for r in requests] == [r.actions for r in again]
    assert {a.fault.side.value for a in actions if a.fault and a.fault.side} == {"left", "right"}
    assert len({str(a.when) for a in actions}) > 18 and len({a.fault.seed for a in actions if a.fault}) > 20
    assert {a.when.state.value for a in actions if a.when.state} <= {"lifting", "folding"}
    assert all(a.when.at_latest for a in actions)


def test_every_action_is_a_valid_script_and_states_the_fault_of_the_table() -> None:
    for request in campaign(seeds=(4,)).requests:
        (name,) = faults_of(request)
        fault = Action.model_validate(request.actions[0]).fault
        assert fault is not None and fault.kind is TABLE.faults[name].kind
        assert (fault.side is not None) == TRAITS[fault.kind].sided
        assert fault.duration_s == TABLE.faults[name].duration_s


def test_pairs_add_a_second_fault_of_another_kind_to_each_recoverable_one() -> None:
    curable = [name for name, entry in TABLE.faults.items() if entry.recoverable]
    pairs = [r for r in campaign(pairs=True).requests if len(r.actions) == 2]
    assert len(pairs) == 2 * 2 * len(curable)
    for request in pairs:
        first, second = faults_of(request)
        assert TABLE.faults[first].kind is not TABLE.faults[second].kind
        assert due_ends(TABLE, (first, second)) == (DueEnd.RECOVERED,)
    assert len({faults_of(r) for r in pairs}) > 2 * len(curable), "partners differ with garment and seed"


def test_faults_are_chosen_by_name_or_kind() -> None:
    assert set(chosen_faults(TABLE, ["slip", "camera_freeze"]).faults) == {
        "slip", "camera_freezes", "camera_freezes_for_good",
    }  # fmt: skip
    with pytest.raises(ConfigurationError, match="no fault 'slips'"):
        chosen_faults(TABLE, ["slips"])


# the judge


@pytest.mark.parametrize(
    ("trial", "end", "due"),
    [
        (ended("slip"), DueEnd.RECOVERED, True),
        (ended("slip", "not_folded"), DueEnd.ASKED, False),
        (ended("slip", "fault"), DueEnd.SAFE, False),
        (ended("slip", score=replace(GOOD, passed=False, iou=0.8)), None, False),
        (ended("slip", score=None), None, False),
        (ended("camera_silent_for_good", "not_folded"), DueEnd.ASKED, True),
        (ended("camera_silent_for_good", "not_folded", failure=replace(ASKING, hint="")), None, False),
        (ended("camera_silent_for_good", "not_folded", seen={"parked": False}), DueEnd.SAFE, False),
        (ended("camera_silent_for_good", "fault"), DueEnd.SAFE, False),
        (ended("camera_silent_for_good"), DueEnd.RECOVERED, False),
        (ended("stop_flaps", "not_folded", "stopped", seen={"parked": False}), DueEnd.SAFE, True),
        (ended("stop_flaps", "not_folded", "stopped", seen={"parked": False, "sent_after_stop": 1}), None, False),
        (ended("stop_flaps"), DueEnd.RECOVERED, False),
        (ended("joint_state_nan_for_good", "fault"), DueEnd.SAFE, True),
        (ended("joint_state_nan_for_good", "not_folded"), DueEnd.ASKED, True),
        (ended("slip", "not_folded", seen={"overdue": True}), None, False),
        (ended("gripper_weak"), DueEnd.RECOVERED, True),
        (ended("gripper_weak", "not_folded"), DueEnd.ASKED, True),
        (Trial(ended("slip").request, None, "it crashed"), None, False),
    ],
)
def test_ends_are_told_apart(trial: Trial, end: DueEnd | None, due: bool) -> None:
    verdict = judge(TABLE, trial)
    assert (verdict.end, verdict.due) == (end, due), verdict.why
    assert verdict.why


def test_drift_is_not_judged_after_a_shove_but_after_a_slip() -> None:
    drifted = replace(GOOD, passed=False, drift_m=0.09)
    assert judge(TABLE, ended("garment_shoved", score=drifted)).due
    assert not judge(TABLE, ended("slip", score=drifted)).due
    assert not judge(TABLE, ended("garment_shoved", score=replace(drifted, iou=0.8))).due


def test_a_run_without_its_fault_proves_nothing() -> None:
    verdict = judge(TABLE, ended("slip", seen={"missed": (MISSED,)}))
    assert verdict.due and not verdict.struck and not verdict.good and "did not happen" in verdict.why


def test_a_run_that_failed_before_its_second_fault_is_a_failure() -> None:
    verdict = judge(TABLE, ended("slip+camera_silent", "not_folded", seen={"missed": (MISSED,)}))
    assert not verdict.due and verdict.struck
    neither = judge(TABLE, ended("slip+camera_silent", "not_folded", seen={"missed": (MISSED, MISSED)}))
    assert not neither.due and not neither.struck, "it failed without any of its faults"


# the results


def test_rows_totals_and_intervals_count_the_runs_in_which_the_fault_happened() -> None:
    trials = (
        ended("slip", seed=1),
        ended("slip", "not_folded", seed=2),
        ended("slip", seed=3, garment="pants"),
        ended("slip", seed=4, seen={"missed": (MISSED,)}),
        ended("slip+camera_silent", seed=1),
        ended("stop_flaps", "not_folded", "stopped"),
        Trial(ended("slip", seed=5).request, None, "killed", performed=False),
    )
    results = FaultResults.of(TABLE, trials)
    rows = {row.name: row for row in results.rows}
    assert list(rows) == ["stop_flaps", "slip", "slip and another"], "in the order of the table, pairs last"
    slip, flaps, two = rows["slip"], rows["stop_flaps"], rows["slip and another"]
    assert slip.all == Group(runs=3, due=2, interval=wilson_interval(2, 3), not_struck=1, not_performed=1)
    assert slip.by_garment["pants"].runs == 1 and flaps.by_garment["pants"].runs == 0
    assert (two.all.runs, two.all.due, two.due_ends) == (1, 1, (DueEnd.RECOVERED,))
    totals = [(name, group.runs, group.due) for name, group in results.totals.items()]
    assert totals == [("recovered", 3, 2), ("safe", 1, 1), ("two faults", 1, 1)]
    assert len(results.runs) == 7


def test_the_page_shows_every_fault_and_fetches_nothing(tmp_path: Path) -> None:
    content = campaign("slip", "camera_black", seeds=(1,))
    folder = CampaignFolder.create(tmp_path, content, tmp_path / "logs")
    run = tmp_path / "slip" / "small_towel-seed1" / "run"
    run.mkdir(parents=True)
    (run / "report.html").write_text("the report")
    failed = ended("slip", "not_folded", failure=replace(ASKING, what="<lost>"), run_dir="/elsewhere/run")
    write_fault_results(TABLE, folder, [failed, ended("camera_black")])
    text = (tmp_path / "faults.html").read_text()
    assert "camera black" in text and 'href="slip/small_towel-seed1/run/report.html"' in text
    assert "1 of 2 runs with a fault ended as due" in text and "unfinished: 2 of 6 runs" in text
    assert "&lt;lost&gt;" in text and "<lost>" not in text
    assert not re.search(r'(src|href)="(https?:)?//|@import|<script', text)


def test_a_campaign_without_runs_has_a_page(tmp_path: Path) -> None:
    folder = CampaignFolder.create(tmp_path, campaign("slip"), tmp_path / "logs")
    write_fault_results(TABLE, folder, [])
    assert "0 of 0 runs" in (tmp_path / "faults.html").read_text()
