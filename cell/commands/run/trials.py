"""`foldcell trials`: performs campaigns of runs over garments, seeds and variants, simulated or with a person."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from foldcell.cell.campaigns.page.campaign_page import PAGE
from foldcell.cell.campaigns.results import CampaignResults
from foldcell.cell.campaigns.statistics.summary import ALL
from foldcell.cell.campaigns.trials.campaign import Campaign, CampaignFile, campaign_of, read_campaign
from foldcell.cell.commands.run.endurance import run_endurance
from foldcell.cell.commands.run.fault_trials import TABLE, add_fault_options, run_fault_trials
from foldcell.cell.commands.run.perform import first_seed, new_campaign, perform, resumed_campaign
from foldcell.cell.commands.shared import (
    answer,
    cell_option,
    count,
    driver_options,
    folder,
    logs_option,
    page_options,
    seed,
    table,
)
from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.driver_names import is_simulated
from foldcell.cell.record.words import figure, garment_name, interval, percent
from foldcell.robots.errors import ConfigurationError

OF_A_NEW_ONE = ("garments", "n", "first_seed", "keep", "cell")
"""Options that only a new campaign takes."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", nargs="?", type=Path, metavar="CAMPAIGN.yaml", help="a campaign file, else flags")
    parser.add_argument("--garments", metavar="A,B", help="names separated by commas, or all (all)")
    parser.add_argument("--n", type=count, metavar="N", help="runs of each garment (10)")
    parser.add_argument("--first-seed", type=seed, metavar="N", help="first seed (1)")
    parser.add_argument("--workers", type=count, metavar="N", help="runs at a time (all cores)")
    parser.add_argument("--cluster", metavar="ADDRESS", help="run on the workers of this Dask scheduler")
    parser.add_argument(
        "--keep", choices=["failures", "all", "none"], help="recordings to keep (failures, or the file's)"
    )
    parser.add_argument(
        "--hours",
        type=_hours,
        metavar="H",
        help="random garments and faults for H hours; what each run leaves behind",
    )
    parser.add_argument(
        "--renew", type=count, metavar="N", help="with --hours: a new process every N runs (never)"
    )
    parser.add_argument("--resume", type=folder, metavar="DIR", help="continue the campaign in this folder")
    add_fault_options(parser)
    driver_options(parser)
    parser.add_argument(
        "--attended", action="store_true",
        help="a person lays each garment and judges each fold (always with --driver ros)",
    )  # fmt: skip
    parser.add_argument("--page", action="store_true", help="with a person: serve the operator's page")
    page_options(parser)
    cell_option(parser)
    logs_option(parser)


def run(options: argparse.Namespace) -> int:
    """Perform a campaign. Returns 0 if every run ended without a fault, 3 if a run ended in a fault or was not
    performed. A bad fold counts in the results but is not an error."""
    attended = options.attended or not is_simulated(options.driver)
    if attended and (options.hours is not None or options.faults is not None):
        raise ConfigurationError(
            "--hours or --faults with a person", "both need a simulated cell without a person"
        )
    if options.hours is not None:
        others = ("file", "resume", "n", "keep", "cluster", "workers", "faults", "only", "pairs")
        _refuse(options, "--hours", others)
        return run_endurance(options)
    if options.faults is not None or (options.resume is not None and (options.resume / TABLE).is_file()):
        _refuse(options, "--faults", ("file",))
        if options.resume is not None:
            _refuse(options, "--resume", (*OF_A_NEW_ONE, "faults", "only", "pairs"))
        return run_fault_trials(options)
    if options.only is not None or options.pairs is not None:
        raise ConfigurationError("--only and --pairs choose among faults", "add --faults")
    if options.renew is not None:
        raise ConfigurationError("--renew without --hours", "campaigns renew their processes by themselves")
    if options.resume is not None:
        _refuse(options, "--resume", ("file", *OF_A_NEW_ONE))
        folder = resumed_campaign(options)
    else:
        folder = new_campaign(_campaign(options), "trials", options)
    trials = perform(folder, options)
    results = CampaignResults.of(folder.campaign, trials)
    code = 3 if any(t.result in ("fault", "not_performed") for t in trials) else 0
    figures = {**results.as_json(), "directory": str(folder.path)}
    return answer(options, figures, _lines(folder.path, results), code)


def _hours(text: str) -> float:
    try:
        hours = float(text)
    except ValueError:
        hours = 0.0
    if not 0.0 < hours <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of hours; up to 1000 is")
    return hours


def _campaign(options: argparse.Namespace) -> Campaign:
    """Return the new campaign. Everything is checked before anything is written."""
    settings = load_settings(options.cell)
    attended = options.attended or not is_simulated(options.driver)
    if options.file is not None:
        _refuse(options, "a campaign file", ("garments", "n", "first_seed"))
        campaign = read_campaign(options.file, settings, options.driver, options.world, attended)
        if options.cell is not None and any(request.python for request in campaign.requests):
            raise ConfigurationError(
                "--cell with a variant of another version, which may have other settings",
                "state the settings that differ in each variant (cell:)",
            )
        return campaign if options.keep is None else replace(campaign, keep=options.keep)
    content = CampaignFile.model_validate({
        "garments": (options.garments or "all").split(","),
        "seeds": {"first": first_seed(options), "count": options.n or 10},
        "keep": options.keep or ("all" if attended else "failures"),
    })  # fmt: skip
    return campaign_of(content, settings, options.driver, options.world, attended)


def _refuse(options: argparse.Namespace, given: str, names: Sequence[str]) -> None:
    stated = [name for name in names if getattr(options, name) is not None]
    both = ["a file" if name == "file" else f"--{name.replace('_', '-')}" for name in stated]
    if both:
        raise ConfigurationError(f"{given} with {', '.join(both)}", f"{given} already states the runs")


def _lines(folder: Path, results: CampaignResults) -> Iterator[str]:
    judge = "the person" if results.campaign.attended else "the scorer"
    yield (
        f"\n{results.campaign.label}; folded: claimed and passed by {judge}; interval: Wilson, 95 %; "
        "times and IoU: medians"
    )
    several = len(results.variants) > 1
    rows = [row for variant in results.variants for row in variant.rows]
    names = (
        "variant", "garment", "folded", "interval", "false claims", "faults", "recoveries", "robot s", "wall s",
        "IoU", "folds/h",
    )  # fmt: skip
    cells = [
        (
            r.variant, garment_name(r.garment), f"{r.folded}/{r.runs}", interval(r.interval), r.false_claims,
            r.faults, r.recoveries, r.robot_time_s, r.wall_time_s, figure("iou", r.iou), r.folds_per_hour,
        )
        for r in rows
    ]  # fmt: skip
    left_out = 0 if several else 1
    yield from table(names[left_out:], [row[left_out:] for row in cells])
    for variant in results.variants:
        counts = variant.claims
        yield (
            f"{variant.name + ': ' if several else ''}claimed and passed {counts.claimed_passed}, "
            f"claimed in error {counts.claimed_failed}, passed but not claimed {counts.unclaimed_passed}, "
            f"neither {counts.unclaimed_failed}; "
            f"precision {percent(counts.precision)}, recall {percent(counts.recall)}"
        )
        for part, found in variant.part_claims.items():
            yield f"  {part} alone: precision {percent(found.precision)}, recall {percent(found.recall)}"
    for first, second, c in results.comparisons:
        yield (
            f"{second} against {first}: {c.pairs} pairs, better in {len(c.only_second)}, worse in "
            f"{len(c.only_first)}, p = {c.p_value:.3f} (McNemar, exact)"
        )
    causes: Counter[str] = Counter()
    for row in rows:
        causes.update(row.causes if row.garment != ALL else {})
    for cause, number in causes.most_common():
        yield f"{number:4d}  {cause}"
    missed = sum(bool(trial.seen and trial.seen.not_done) for trial in results.trials)
    if missed:
        yield f"{missed} runs ended before all that their variant's script states had happened"
    if results.not_performed:
        yield f"{len(results.not_performed)} runs were not performed: see the messages above"
    yield f"details  {folder / PAGE}"
