"""Perform the runs of a campaign's folder, with progress and advice how to continue."""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
from collections.abc import Callable
from typing import Any

from cell.campaigns.executors import RUNS_EACH, chosen_workers
from cell.campaigns.perform_campaign import perform_campaign
from cell.campaigns.trials.progress import CampaignProgress
from cell.campaigns.trials.store import CampaignFolder
from cell.campaigns.trials.trial import Trial
from cell.commands.output import progress_stream
from cell.support.files.paths import command_for
from robots.errors import ConfigurationError, StorageError

__all__ = ["perform"]


def perform(
    campaign: CampaignFolder,
    options: argparse.Namespace,
    write: Callable[[CampaignFolder, list[Trial]], Any] | None = None,
    describe: Callable[[Trial], str] | None = None,
) -> list[Trial]:
    """Perform the missing runs on the workers that the options name. Returns all runs. write: writes the results;
    describe: text about a run that has ended; None: as for any campaign.

    An interrupted campaign says how to continue it. Raises what `perform_campaign` raises.
    """
    out = progress_stream(options.json)
    with campaign.owned():
        finished = campaign.finished()
        missing = len(campaign.missing(finished))
        try:
            with chosen_workers(options.workers, options.cluster, campaign.path, RUNS_EACH) as workers:
                for note in workers.notes:
                    print(note, file=sys.stderr)
                already = f", {len(finished)} of them finished earlier" if finished else ""
                print(f"{missing + len(finished)} runs{already}, {workers.count} at a time", file=out, flush=True)
                print(f"folder   {campaign.path}", file=out, flush=True)
                total = missing + len(finished)
                progress = CampaignProgress(total, len(finished), workers.count, describe=describe)
                return perform_campaign(
                    campaign, workers, lambda t: print(progress.line(t), file=out, flush=True), write=write
                )
        except ConfigurationError:  # the workers cannot be had: leave no campaign that never began
            if options.resume is None and not campaign.finished():
                shutil.rmtree(campaign.path)
            raise
        except (KeyboardInterrupt, StorageError):
            made = len(campaign.finished())
            again = command_for(f"trials --resume {shlex.quote(str(campaign.path))}", campaign.path.parent)
            print(f"{made} of {missing + len(finished)} runs are finished; continue: {again}", file=sys.stderr)
            raise
