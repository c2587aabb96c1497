"""Performs a campaign: starts the missing runs, and keeps the results and the page up to date."""

from __future__ import annotations

import functools
import sys
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import closing
from pathlib import Path

from foldcell.cell.campaigns.executors import Workers
from foldcell.cell.campaigns.results import RESULTS, CampaignResults
from foldcell.cell.campaigns.trials.campaign import Keep, TrialRequest
from foldcell.cell.campaigns.trials.perform_trial import Fold, perform_trial
from foldcell.cell.campaigns.trials.store import CampaignFolder, program_versions
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.cell.support.files.whole_file import write_whole
from foldcell.cell.support.json_values import write_json
from foldcell.robots.errors import StorageError

ATTEMPTS = 3
"""Maximum number of starts of a run. A run is started again only if its worker process died."""
WRITE_EVERY_S = 10.0
"""Shortest time between two updates of the results and the page. Finished runs are safe meanwhile, because each is
stored in its own folder."""
Write = Callable[[CampaignFolder, list[Trial]], None]


def write_results(folder: CampaignFolder, trials: list[Trial]) -> None:
    """Write `trials.json` and `campaign.html`. Raises StorageError."""
    from foldcell.cell.campaigns.page.campaign_page import PAGE, campaign_page

    results = CampaignResults.of(folder.campaign, trials)
    write_json(folder.path / RESULTS, results.as_json())
    write_whole(folder.path / PAGE, campaign_page(folder, results))


def perform_campaign(
    folder: CampaignFolder,
    workers: Workers,
    report: Callable[[Trial], None],
    fold: Fold | None = None,
    write: Write = write_results,
) -> list[Trial]:
    """Perform the runs that are missing. Returns all runs, old and new. report: called after each run. fold: see
    `perform_trial`. write: writes the results and the page.

    The results so far are also written if the campaign is interrupted. Raises StorageError if the folder cannot be
    written.
    """
    trials = folder.finished()
    sources = program_versions()["sources"]
    work = functools.partial(_perform, str(folder.path), folder.campaign.keep, fold, sources)
    written = 0.0
    try:
        write(folder, trials)
        with closing(run_trials(folder.missing(trials), work, workers)) as running:
            for trial in running:
                trials.append(trial)
                report(trial)
                if time.monotonic() - written > WRITE_EVERY_S:
                    write(folder, trials)
                    written = time.monotonic()
    finally:
        write(folder, trials)
    return trials


def run_trials(
    requests: Sequence[TrialRequest], work: Callable[[TrialRequest], Trial], workers: Workers
) -> Generator[Trial, None, None]:
    """Yield each run as it ends, in any order. work: performs a run, in a worker process.

    A run whose worker process died is started up to ATTEMPTS times in all; then it counts as not performed. So
    does a run whose work raises any other exception, because `perform_trial` turns a run's own exceptions into
    results. StorageError is raised: a campaign cannot go on without its folder."""
    begun: Counter[int] = Counter()
    running: dict[Future[Trial], int] = {}

    def start(index: int) -> None:
        begun[index] += 1
        running[workers.executor.submit(work, requests[index])] = index

    try:
        for index in range(len(requests)):
            start(index)
        while running:
            for job in wait(running, return_when=FIRST_COMPLETED).done:
                index = running.pop(job)
                error = CancelledError() if job.cancelled() else job.exception()
                if error is None:
                    yield job.result()
                elif isinstance(error, StorageError):
                    raise error
                elif workers.died(error) and begun[index] < ATTEMPTS:
                    start(index)
                else:
                    died = f"its worker process died {ATTEMPTS} times ({type(error).__name__})"
                    why = died if workers.died(error) else f"{type(error).__name__}: {error}"
                    yield Trial(requests[index], None, why, performed=False)
    finally:
        for job in running:
            job.cancel()


def _perform(campaign: str, keep: Keep, fold: Fold | None, sources: str, request: TrialRequest) -> Trial:
    """Perform one run. Called in a worker process.

    Raises StorageError if the program's files have changed since the campaign was started: a process that starts
    later would run another program.
    """
    if program_versions()["sources"] != sources:
        raise StorageError(
            "the program's files changed while the campaign ran", "continue it with the version that began it"
        )
    with report_compilation(lambda line: print(f"           {line}", file=sys.stderr, flush=True)):
        return perform_trial(request, Path(campaign) / request.folder, keep, fold)
