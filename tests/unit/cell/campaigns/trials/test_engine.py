"""The engine: every run ends once, whatever becomes of its worker."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import pytest

from cell.campaigns.trials.campaign import TrialRequest
from cell.campaigns.trials.engine import ATTEMPTS, process_died, run_trials
from robots.errors import StorageError
from tests.builders.campaigns import figures, request


def done(request: TrialRequest) -> dict[str, Any]:
    return {"figures": figures(robot_time_s=float(request.seed)), "error": ""}


def test_a_run_whose_worker_cannot_perform_it_is_not_performed_and_the_others_go_on() -> None:
    def work(request: TrialRequest) -> dict[str, Any]:
        if request.seed == 2:
            raise RuntimeError("broken")
        return done(request)

    with ThreadPoolExecutor(2) as pool:
        trials = list(run_trials([request(s) for s in (1, 2, 3)], work, pool, process_died))
    assert {t.request.seed: t.result for t in trials} == {1: "folded", 2: "not_performed", 3: "folded"}
    assert next(t for t in trials if t.request.seed == 2).error == "RuntimeError: broken"


def test_a_run_whose_worker_dies_is_started_again() -> None:
    begun: Counter[int] = Counter()

    def work(request: TrialRequest) -> dict[str, Any]:
        begun[request.seed] += 1
        if request.seed == 2 and begun[2] < ATTEMPTS:
            raise BrokenProcessPool("killed")
        return done(request)

    with ThreadPoolExecutor(1) as pool:
        trials = list(run_trials([request(s) for s in (1, 2, 3)], work, pool, process_died))
    assert sorted((t.request.seed, t.result) for t in trials) == [(1, "folded"), (2, "folded"), (3, "folded")]
    assert begun == {1: 1, 2: ATTEMPTS, 3: 1}


def test_a_run_whose_workers_always_die_is_not_performed() -> None:
    def work(request: TrialRequest) -> dict[str, Any]:
        raise BrokenProcessPool("killed")

    with ThreadPoolExecutor(1) as pool:
        (trial,) = run_trials([request()], work, pool, process_died)
    assert not trial.performed and trial.result == "not_performed"


def test_a_folder_that_cannot_be_written_ends_the_campaign() -> None:
    def work(request: TrialRequest) -> dict[str, Any]:
        raise StorageError("the disk is full", "free some space")

    with ThreadPoolExecutor(1) as pool, pytest.raises(StorageError):
        list(run_trials([request(1), request(2)], work, pool, process_died))
