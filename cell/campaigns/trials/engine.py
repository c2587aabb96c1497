"""Sends the runs of a campaign to an executor and yields each run when it has finished."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from typing import Any

from cell.campaigns.trials.campaign import TrialRequest
from cell.campaigns.trials.trial import Trial
from robots.errors import StorageError

__all__ = ["ATTEMPTS", "process_died", "run_trials"]

ATTEMPTS = 3
"""Maximum number of starts of a run. A run is started again only if its worker process died."""

Work = Callable[[TrialRequest], dict[str, Any]]


def run_trials(
    requests: Sequence[TrialRequest], work: Work, executor: Executor, worker_died: Callable[[BaseException], bool]
) -> Generator[Trial, None, None]:
    """Yield each run as it ends, in any order. `work(request)` returns the content of `trial.json`.

    worker_died: whether an exception means that the worker process died. Such a run is started up to ATTEMPTS
    times in all; then it counts as not performed. So does a run whose work raises any other exception, because
    `perform_trial` turns a run's own exceptions into results. StorageError is raised: a campaign cannot go on
    without its folder.
    """
    begun: Counter[int] = Counter()
    running: dict[Future[dict[str, Any]], int] = {}

    def start(index: int) -> None:
        begun[index] += 1
        running[executor.submit(work, requests[index])] = index

    try:
        for index in range(len(requests)):
            start(index)
        while running:
            for job in wait(running, return_when=FIRST_COMPLETED).done:
                index = running.pop(job)
                error = CancelledError() if job.cancelled() else job.exception()
                if isinstance(error, StorageError):
                    raise error
                if error is None:
                    done = job.result()
                    yield Trial(requests[index], done["figures"], done["error"])
                elif not worker_died(error):
                    yield Trial(requests[index], None, f"{type(error).__name__}: {error}", performed=False)
                elif begun[index] < ATTEMPTS:
                    start(index)
                else:
                    text = f"its worker process died {ATTEMPTS} times ({type(error).__name__})"
                    yield Trial(requests[index], None, text, performed=False)
    finally:
        for job in running:
            job.cancel()


def process_died(error: BaseException) -> bool:
    """Whether the exception means that a worker process of a standard-library pool died."""
    return isinstance(error, BrokenExecutor | CancelledError)
