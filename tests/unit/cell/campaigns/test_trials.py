"""Campaigns: Wilson's interval, and the table of results."""

from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from cell.campaigns.trials import Trial, run_trials, tabulate, wilson_interval


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_confidence_interval_agrees_with_scipy(counts: tuple[int, int]) -> None:
    k, n = counts
    expected = binomtest(k, n).proportion_ci(method="wilson")
    assert wilson_interval(k, n) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_the_confidence_interval_of_the_papers_result_agrees_with_the_paper() -> None:
    low, high = wilson_interval(65, 70)
    assert (round(low, 2), round(high, 2)) == (0.84, 0.97)


def test_zero_runs_give_the_full_interval() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="3 of 2"):
        wilson_interval(3, 2)


def figures(result: str, passed: bool | None, robot: float = 60.0) -> dict[str, Any]:
    score = None if passed is None else {"passed": passed, "iou": 0.9}
    return {"result": result, "score": score, "robot_time_s": robot, "wall_time_s": 1.0,
            "steps": [{"recoveries": ["lower", "inward"]}, {"recoveries": 1}]}  # fmt: skip


def test_success_is_decided_by_the_scorer() -> None:
    assert Trial("g", 1, figures("folded", True)).success
    assert not Trial("g", 1, figures("folded", False)).success  # a false claim: the scorer did not pass the run
    assert not Trial("g", 1, figures("not_folded", True)).success
    assert Trial("g", 1, figures("folded", None)).success  # on hardware there is no scorer
    assert not Trial("g", 1, None, "crashed").success


def test_rows_count_results_recoveries_and_failures() -> None:
    trials = [
        Trial("b", 1, figures("folded", True, 50.0)),
        Trial("b", 2, figures("folded", False, 70.0)),
        Trial("b", 3, None, "crashed"),
        Trial("a", 1, figures("not_folded", False, 90.0)),
    ]
    a, b, both = tabulate(trials)
    assert (a.garment, b.garment, both.garment) == ("a", "b", "all")
    assert (b.runs, b.folded, b.false_claims, b.faults, b.recoveries) == (3, 1, 1, 1, 6)
    assert b.robot_time_s == 60.0 and b.iou == 0.9
    assert (both.runs, both.folded) == (4, 1)


def test_a_crashed_run_counts_as_a_fault_and_other_runs_continue() -> None:
    def work(garment: str, seed: int) -> dict[str, Any]:
        if seed == 2:
            raise RuntimeError("broken")
        return figures("folded", True)

    with ThreadPoolExecutor(2) as pool:
        trials = list(run_trials(work, ["g"], [1, 2, 3], pool))
    assert {t.seed: t.result for t in trials} == {1: "folded", 2: "fault", 3: "folded"}
    assert next(t for t in trials if t.seed == 2).error == "RuntimeError: broken"


def test_runs_of_a_dead_worker_count_as_not_performed() -> None:
    """They are not faults of the cell and are not in the table."""

    def work(garment: str, seed: int) -> dict[str, Any]:
        if seed > 1:
            raise BrokenProcessPool("a worker was killed")
        return figures("folded", True)

    with ThreadPoolExecutor(1) as pool:
        trials = list(run_trials(work, ["g"], [1, 2, 3], pool))
    assert {t.seed: t.result for t in trials} == {1: "folded", 2: "not_performed", 3: "not_performed"}
    (row,) = tabulate(trials)
    assert (row.runs, row.folded, row.faults) == (1, 1, 0)
