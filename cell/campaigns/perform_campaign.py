"""Performs a campaign: starts the missing runs, and keeps the results and the page up to date."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from cell.campaigns.executors import Workers
from cell.campaigns.results import RESULTS, campaign_results, results_text
from cell.campaigns.trials.campaign import Keep, TrialRequest
from cell.campaigns.trials.engine import run_trials
from cell.campaigns.trials.perform_trial import Fold, perform_trial
from cell.campaigns.trials.store import CampaignFolder, program_versions
from cell.campaigns.trials.trial import Trial
from cell.operator.progress.compiling import report_compilation
from cell.support.files.whole_file import write_whole
from robots.errors import StorageError

__all__ = ["perform_campaign"]

WRITE_EVERY_S = 10.0
"""Shortest time between two updates of the results and the page. Finished runs are safe meanwhile, because each is
stored in its own folder."""


def perform_campaign(
    folder: CampaignFolder,
    workers: Workers,
    report: Callable[[Trial], None],
    fold: Fold | None = None,
    write: Callable[[CampaignFolder, list[Trial]], Any] | None = None,
) -> list[Trial]:
    """Perform the runs that are missing. Returns all runs, old and new. report: called after each run. fold: see
    `perform_trial`. write: writes the results and the page; None: those of any campaign.

    The results so far are also written if the campaign is interrupted. Raises StorageError if the folder cannot be
    written.
    """
    trials = folder.finished()
    missing = folder.missing(trials)
    sources = program_versions()["sources"]
    work = functools.partial(_perform, str(folder.path), folder.campaign.keep, fold, sources)
    written = 0.0
    write = write or write_results
    try:
        write(folder, trials)
        with closing(run_trials(missing, work, workers.executor, workers.died)) as running:
            for trial in running:
                trials.append(trial)
                report(trial)
                if time.monotonic() - written > WRITE_EVERY_S:
                    write(folder, trials)
                    written = time.monotonic()
    finally:
        write(folder, trials)
    return trials


def write_results(folder: CampaignFolder, trials: list[Trial]) -> dict[str, Any]:
    """Write `trials.json` and `campaign.html`. Raises StorageError."""
    from cell.campaigns.page.campaign_page import PAGE, campaign_page

    results = campaign_results(folder.campaign, trials)
    write_whole(folder.path / RESULTS, results_text(results))
    write_whole(folder.path / PAGE, campaign_page(folder, trials))
    return results


def _perform(campaign: str, keep: Keep, fold: Fold | None, sources: str, request: TrialRequest) -> dict[str, Any]:
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
