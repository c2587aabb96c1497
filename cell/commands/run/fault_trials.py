"""`foldcell trials --faults`: performs the table of faults and compares each end with the due one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from foldcell.cell.campaigns.faults.fault_table import SHIPPED, FaultTable, read_fault_table
from foldcell.cell.campaigns.faults.fault_trials import chosen_faults, fault_campaign, faults_of
from foldcell.cell.campaigns.faults.judge import judge
from foldcell.cell.campaigns.faults.results import FaultResults, Group
from foldcell.cell.campaigns.page.fault_page import PAGE, write_fault_results
from foldcell.cell.campaigns.trials.campaign import distinct_garments
from foldcell.cell.campaigns.trials.store import CampaignFolder
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.commands.run.perform import first_seed, new_campaign, perform, resumed_campaign
from foldcell.cell.commands.shared import answer, table
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.record.words import garment_name, interval
from foldcell.cell.support.files.whole_file import write_whole

TABLE = "fault_table.yaml"
"""Copy of the table in the folder of its campaign."""
GARMENTS = ("small_towel", "medium_towel", "t_shirt", "long_sleeve_shirt_small", "pants")
SEEDS = 2


def add_fault_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--faults",
        nargs="?",
        const=SHIPPED,
        type=Path,
        metavar="TABLE.yaml",
        help="each fault of a table (the shipped one, docs/look_up/faults.md) and whether the run ends as due",
    )
    parser.add_argument("--only", metavar="A,B", help="with --faults: these faults or kinds (all)")
    parser.add_argument("--pairs", action="store_true", default=None, help="with --faults: also two in one run")


def run_fault_trials(options: argparse.Namespace) -> int:
    """Perform the table of faults, or continue it. Returns 0 if every run ended as due, 2 if one did not or if its
    fault did not happen, 3 if a run was not performed."""
    folder = _new(options) if options.resume is None else resumed_campaign(options)
    faults = read_fault_table(folder.path / TABLE)
    trials = perform(folder, options, partial(write_fault_results, faults), partial(_line, faults))
    results = FaultResults.of(faults, trials)
    code = 0 if all(verdict.good for _, verdict in results.runs) else 2
    if any(not trial.performed for trial in trials):
        code = 3
    figures = {**results.as_json(), "directory": str(folder.path)}
    return answer(options, figures, _lines(results, folder.path), code)


def _new(options: argparse.Namespace) -> CampaignFolder:
    """Return the folder of a new campaign. Everything is checked before anything is written."""
    faults, first = read_fault_table(options.faults), first_seed(options)
    if options.only is not None:
        faults = chosen_faults(faults, [name.strip() for name in options.only.split(",")])
    campaign = fault_campaign(
        faults,
        GARMENTS if options.garments is None else distinct_garments(options.garments.split(",")),
        range(first, first + (options.n or SEEDS)),
        load_settings(options.cell),
        driver=options.driver,
        world=options.world,
        pairs=bool(options.pairs),
        keep=options.keep or "failures",
    )
    folder = new_campaign(campaign, "faults", options)
    write_whole(folder.path / TABLE, options.faults.read_text(encoding="utf-8"))
    return folder


def _line(faults: FaultTable, trial: Trial) -> str:
    """Return the line of a run that has just ended."""
    verdict = judge(faults, trial)
    garment, seed = garment_name(trial.request.garment), trial.request.seed
    name = f"{' and '.join(faults_of(trial.request))}, {garment} seed {seed}"
    word = "as due" if verdict.good else "without the fault" if verdict.due else "NOT AS DUE"
    return f"{name:<60} {verdict.end or '-':<10} {word:<17}" + ("" if verdict.good else f" {verdict.why}")


def _lines(results: FaultResults, folder: Path) -> Iterator[str]:
    yield "\nsimulated; runs that ended as due, of those in which the fault happened; interval: Wilson, 95 %"
    yield from table(
        ("fault", "due", *map(garment_name, results.garments), "all", "interval"),
        [
            (
                row.name,
                " or ".join(row.due_ends),
                *(_share(row.by_garment[garment]) for garment in results.garments),
                _share(row.all),
                interval(row.all.interval),
            )
            for row in results.rows
        ],
    )
    for name, group in results.totals.items():
        yield f"{name}: {_share(group)} ({interval(group.interval)})"
    yield f"details  {folder / PAGE}"


def _share(group: Group) -> str:
    left = f" +{group.not_struck} without" if group.not_struck else ""
    return f"{group.due}/{group.runs}{left}" if group.runs or left else "-"
