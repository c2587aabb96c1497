"""The engine: every run ends once, whatever becomes of its worker."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import pytest

from foldcell.cell.campaigns.executors import Workers
from foldcell.cell.campaigns.perform_campaign import ATTEMPTS, run_trials
from foldcell.cell.campaigns.trials.campaign import TrialRequest
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.robots.errors import StorageError
from tests.builders.campaigns import record, request


def done(request: TrialRequest) -> Trial:
    return Trial(request, record())


def test_a_run_whose_worker_cannot_perform_it_is_not_performed_and_the_others_go_on() -> None:
    def work(request: TrialRequest) -> Trial:
        if request.seed == 2:
            raise RuntimeError("broken")
        return done(request)

    with ThreadPoolExecutor(2) as pool:
        trials = list(run_trials([request(s) for s in (1, 2, 3)], work, Workers(pool, 1)))
    assert {t.request.seed: t.result for t in trials} == {1: "folded", 2: "not_performed", 3: "folded"}
    assert next(t for t in trials if t.request.seed == 2).error == "RuntimeError: broken"


def test_a_run_whose_worker_dies_is_started_again() -> None:
    begun: Counter[int] = Counter()

    def work(request: TrialRequest) -> Trial:
        begun[request.seed] += 1
        if request.seed == 2 and begun[2] < ATTEMPTS:
            raise BrokenProcessPool("killed")
        return done(request)

    with ThreadPoolExecutor(1) as pool:
        trials = list(run_trials([request(s) for s in (1, 2, 3)], work, Workers(pool, 1)))
    assert sorted((t.request.seed, t.result) for t in trials) == [(1, "folded"), (2, "folded"), (3, "folded")]
    assert begun == {1: 1, 2: ATTEMPTS, 3: 1}


def test_a_run_whose_workers_always_die_is_not_performed() -> None:
    def work(request: TrialRequest) -> Trial:
        raise BrokenProcessPool("killed")

    with ThreadPoolExecutor(1) as pool:
        (trial,) = run_trials([request()], work, Workers(pool, 1))
    assert not trial.performed and trial.result == "not_performed"


def test_a_folder_that_cannot_be_written_ends_the_campaign() -> None:
    def work(request: TrialRequest) -> Trial:
        raise StorageError("the disk is full", "free some space")

    with ThreadPoolExecutor(1) as pool, pytest.raises(StorageError):
        list(run_trials([request(1), request(2)], work, Workers(pool, 1)))
