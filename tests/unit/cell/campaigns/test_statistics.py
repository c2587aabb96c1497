"""Statistics of campaigns against closed forms and properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from foldcell.cell.campaigns.statistics.comparison import compare_trials
from foldcell.cell.campaigns.statistics.proportions import bootstrap_median, mcnemar_exact, wilson_interval
from foldcell.cell.campaigns.statistics.summary import claims, part_claims, summarise
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.run_record import IdealRecord
from foldcell.robots.errors import FailureKind
from tests.builders.campaigns import request, trial
from tests.builders.records import score_record
from tests.inspections import a_claim


def test_the_interval_of_the_papers_result() -> None:
    """65 of 70 folds: 84 to 97 %."""
    low, high = wilson_interval(65, 70)
    assert (round(low, 2), round(high, 2)) == (0.84, 0.97)


def test_no_runs_leave_every_rate_possible() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)


@given(st.integers(0, 300), st.integers(0, 300))
def test_interval_and_p_value_are_those_of_scipy(b: int, c: int) -> None:
    peer = binomtest(b, b + c) if b + c else None
    interval = peer.proportion_ci(0.95, "wilson") if peer else (0.0, 1.0)
    assert wilson_interval(b, b + c) == pytest.approx(tuple(interval), rel=1e-9, abs=1e-12)
    assert mcnemar_exact(b, c) == pytest.approx(peer.pvalue if peer else 1.0, rel=1e-9)


@pytest.mark.long
def test_the_bootstrap_interval_covers_the_median_as_often_as_it_claims() -> None:
    """Of a normal distribution, 30 values each: 95 % within the error of 300 draws (binomial, 4 sigma)."""
    generator = np.random.default_rng(1)
    covered = 0
    for _ in range(300):
        interval = bootstrap_median(generator.normal(size=30).tolist())
        assert interval is not None
        covered += interval[0] <= 0.0 <= interval[1]
    assert covered / 300 == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 300))


def test_a_single_value_has_no_interval() -> None:
    assert bootstrap_median([1.0]) is None


def test_a_success_is_claimed_and_passed() -> None:
    assert trial().success
    assert not trial(passed=False).success, "a false claim"
    assert not trial(result="not_folded").success, "a good fold that is not claimed"
    assert trial(passed=None).success, "hardware has no scorer"
    assert not Trial(request(), None, "crashed").success


def test_rows_count_results_recoveries_and_causes() -> None:
    trials = [
        trial(1, "b", robot_time_s=50.0),
        trial(2, "b", passed=False, robot_time_s=70.0, height_m=0.03),
        Trial(request(3, "b"), None, "crashed"),
        trial(1, "a", result="not_folded", passed=False, failure=FailureKind.SLIPPED, robot_time_s=90.0),
        Trial(request(4, "b"), None, "its worker died", performed=False),
    ]
    a, b, both = summarise(trials)
    assert (a.garment, b.garment, both.garment) == ("a", "b", "all")
    assert (b.runs, b.folded, b.false_claims, b.faults, b.recoveries) == (3, 1, 1, 1, 4)
    assert b.robot_time_s == 60.0
    assert b.causes == {"score: IoU, height": 1, "error": 1} and a.causes == {"slipped": 1}
    assert (both.runs, both.folded) == (4, 1)
    assert b.folds_per_hour == pytest.approx(3600.0 / 120.0), "failures take time too"


def test_an_ideal_fold_that_is_not_valid_is_a_cause_of_its_own() -> None:
    ideal = IdealRecord(False, "it does not come to rest")
    score = score_record({"iou": 0.9}, passed=False, flat=None, iou=0.95, ideal=ideal)
    judged = trial(1, "b", score=score)
    assert judged.cause == "score: ideal" and judged.passed is False and not judged.success


def test_claims_and_verdicts_make_a_table_of_two_by_two() -> None:
    table = claims(
        [
            *(trial(s) for s in range(6)),
            *(trial(s, passed=False) for s in range(2)),
            trial(result="not_folded"),
            trial(result="not_folded", passed=False),
            trial(passed=None),
        ]
    )
    assert (table.claimed_passed, table.claimed_failed) == (6, 2)
    assert (table.unclaimed_passed, table.unclaimed_failed) == (1, 1)
    assert table.precision == pytest.approx(6 / 8) and table.recall == pytest.approx(6 / 7)


def test_the_parts_of_a_claim_are_counted_apart() -> None:
    """Runs without a claim, and scores without the part, do not count."""

    def judged(claim: dict[str, bool] | None, score: dict[str, bool | None] | None) -> Trial:
        return trial(
            claim=None if claim is None else replace(a_claim(), **claim),
            score=None if score is None else score_record(**score),
        )

    good, high = {"shape": True, "flat": True}, {"shape": True, "flat": False}
    found = part_claims(
        [
            *(judged(good, good) for _ in range(4)),
            judged(good, high),
            judged(high, high),
            judged(high, good),
            judged(good, {"shape": True, "flat": None}),
            judged(None, good),
            judged(good, None),
            trial(),
        ]
    )
    flat = found["flat"]
    assert (flat.claimed_passed, flat.claimed_failed, flat.unclaimed_passed, flat.unclaimed_failed) == (4, 1, 1, 1)
    assert found["shape"].claimed_passed == 8 and found["shape"].recall == 1.0
    assert part_claims([trial()]) == {}


def test_runs_are_compared_on_the_same_garment_and_seed() -> None:
    first = [trial(s, robot_time_s=40.0 + s) for s in range(5)] + [trial(1, "shirt")]
    second = [
        trial(0, robot_time_s=43.0),
        trial(1, passed=False, robot_time_s=44.0),
        trial(2, robot_time_s=45.0, height_m=0.018),
        trial(3, passed=False, result="not_folded", failure=FailureKind.SAG, robot_time_s=46.0),
        Trial(request(4), None, "its worker died", performed=False),
        trial(9),
    ]
    c = compare_trials(first, second)
    assert (c.pairs, c.both, c.neither, c.unpaired) == (4, 2, 0, 3)
    assert c.only_first == (("towel", 1), ("towel", 3)) and c.only_second == ()
    assert c.p_value == pytest.approx(0.5)
    assert c.robot_time_difference_s == pytest.approx(3.0)
    assert c.second_causes == {"score: IoU": 1, "sag": 1}


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=20))
def test_a_comparison_the_other_way_round_is_its_mirror(pairs: list[tuple[bool, bool]]) -> None:
    first = [trial(s, passed=a) for s, (a, _) in enumerate(pairs)]
    second = [trial(s, passed=b) for s, (_, b) in enumerate(pairs)]
    one, other = compare_trials(first, second), compare_trials(second, first)
    assert one.only_first == other.only_second and one.only_second == other.only_first
    assert (one.both, one.neither, one.p_value) == (other.both, other.neither, other.p_value)
    assert one.both + one.neither + len(one.only_first) + len(one.only_second) == len(pairs)
