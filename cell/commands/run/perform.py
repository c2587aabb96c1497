"""Open the folder of a campaign and perform its runs, with progress and advice how to continue."""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable

from foldcell.cell.campaigns.executors import RUNS_EACH, chosen_workers
from foldcell.cell.campaigns.perform_campaign import Write, perform_campaign, write_results
from foldcell.cell.campaigns.trials.campaign import Campaign, TrialRequest
from foldcell.cell.campaigns.trials.progress import CampaignProgress, described
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.commands.shared import teller
from foldcell.cell.hardware.placement import refuse_unfit_folds
from foldcell.cell.support.files.paths import campaign_folder, command_for, logs_directory, prepare_logs, space_for
from foldcell.robots.errors import ConfigurationError, DriverError, StorageError


def first_seed(options: argparse.Namespace) -> int:
    """Return the first seed of a new campaign. The option itself has no default, so that its use can be noticed
    and refused."""
    return 1 if options.first_seed is None else int(options.first_seed)


def new_campaign(campaign: Campaign, kind: str, options: argparse.Namespace) -> CampaignFolder:
    """Create the folder of a campaign in the logs. kind: beginning of its name. Raises StorageError, and
    ConfigurationError for a cell or garment that every run would refuse."""
    _check_cells(campaign.requests)
    logs = prepare_logs(logs_directory(options.logs), space_for(_kept(campaign)))
    return CampaignFolder.create(campaign_folder(logs, kind), campaign, logs)


def resumed_campaign(options: argparse.Namespace) -> CampaignFolder:
    """Open the campaign that `--resume` names. Raises ConfigurationError if it cannot be continued, StorageError
    if its runs cannot be written."""
    folder = CampaignFolder.open(options.resume.absolute())
    folder.check_program()
    prepare_logs(folder.path, space_for(_kept(folder.campaign) - len(folder.finished())))
    return folder


def _check_cells(requests: Iterable[TrialRequest]) -> None:
    """Check each cell with each garment as a run does before it begins. Another version of foldcell checks its
    runs itself. Raises ConfigurationError that names the variant."""
    cells: dict[str, tuple[TrialRequest, dict[str, None]]] = {}
    for request in requests:
        if request.python is None:
            cells.setdefault(json.dumps(request.settings), (request, {}))[1][request.garment] = None
    for request, garments in cells.values():
        try:
            refuse_unfit_folds(garments, request.cell)
        except ConfigurationError as e:
            raise ConfigurationError(f"{request.variant}: {e.what}" if len(cells) > 1 else e.what, e.hint) from e


def _kept(campaign: Campaign) -> int:
    """Return the number of runs whose recordings are surely kept."""
    return len(campaign.requests) if campaign.keep == "all" else 1


def perform(
    campaign: CampaignFolder,
    options: argparse.Namespace,
    write: Write = write_results,
    describe: Callable[[Trial], str] = described,
) -> list[Trial]:
    """Perform the missing runs on the workers that the options name. Returns all runs. write: writes the results;
    describe: returns the text about a run that has ended.

    If the campaign is interrupted, a message says how to continue it. Raises what `perform_campaign` raises.
    """
    with campaign.owned():
        try:
            if campaign.campaign.attended:
                trials = _attended(campaign, options)
            else:
                trials = _on_workers(campaign, options, write, describe)
        except ConfigurationError:
            if options.resume is None and not campaign.finished():  # do not leave a campaign that never began
                shutil.rmtree(campaign.path)
            raise
        except (KeyboardInterrupt, StorageError, DriverError):
            _say_how_to_continue(campaign)
            raise
        if campaign.campaign.attended:
            _say_how_to_continue(campaign)
        return trials


def _on_workers(
    campaign: CampaignFolder, options: argparse.Namespace, write: Write, describe: Callable[[Trial], str]
) -> list[Trial]:
    tell = teller(options.json)
    finished, total = len(campaign.finished()), len(campaign.campaign.requests)
    with chosen_workers(options.workers, options.cluster, campaign.path, RUNS_EACH) as workers:
        for note in workers.notes:
            print(note, file=sys.stderr)
        already = f", {finished} of them finished earlier" if finished else ""
        tell(f"{total} runs{already}, {workers.count} at a time\nfolder   {campaign.path}")
        progress = CampaignProgress(total, finished, workers.count, describe)
        return perform_campaign(campaign, workers, lambda t: tell(progress.line(t)), write=write)


def _attended(campaign: CampaignFolder, options: argparse.Namespace) -> list[Trial]:
    """Perform the missing runs with a person, until the person ends the day."""
    if options.workers is not None or options.cluster is not None:
        raise ConfigurationError("--workers and --cluster with a person", "a person attends one run at a time")
    from foldcell.cell.campaigns.trials.attended import Session, attended_trials, judge_later

    tell, trials = teller(options.json), campaign.finished()
    tell(f"folder   {campaign.path}")
    session = Session(options.page, options.page_port, options.page_origin or "", options.json)
    progress = CampaignProgress(len(campaign.campaign.requests), len(trials), 1)
    write_results(campaign, trials)
    for trial in attended_trials(campaign, session.perform, judge_later):
        trials.append(trial)
        tell(progress.line(trial))
        write_results(campaign, trials)
    return trials


def _say_how_to_continue(campaign: CampaignFolder) -> None:
    finished, total = len(campaign.finished()), len(campaign.campaign.requests)
    if finished < total or not campaign.campaign.attended:
        again = command_for(f"trials --resume {shlex.quote(str(campaign.path))}", campaign.path.parent)
        print(f"{finished} of {total} runs are finished; continue: {again}", file=sys.stderr)
