"""`foldcell compare`: compares two campaigns on the same garments and seeds, or two runs."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from foldcell.cell.campaigns.statistics.comparison import Comparison, compare_trials
from foldcell.cell.campaigns.trials.store import CampaignFolder, changed_versions, is_campaign
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.commands.options import json_option, logs_option
from foldcell.cell.commands.output import print_json, print_table
from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.words import difference, garment_name, value_in_words
from foldcell.cell.runs.run_difference import Difference, RunDifference, run_difference
from foldcell.cell.support.files.paths import journal_path, logs_directory
from foldcell.robots.errors import ConfigurationError

__all__ = ["add_options", "run"]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(run=run)
    parser.add_argument("first", metavar="A", help="a campaign's folder, or a run (id, folder or last)")
    parser.add_argument("second", metavar="B", help="another one, which is compared with the first")
    parser.add_argument(
        "--variant", metavar="NAME", help="the variant of both campaigns (every variant that both have)"
    )
    logs_option(parser)
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print the differences. Always returns 0."""
    campaigns = [_campaign(name, options) for name in (options.first, options.second)]
    if all(campaigns):
        a, b = (CampaignFolder.open(path) for path in campaigns if path)
        return _campaigns(a, b, options)
    if any(campaigns):
        raise ConfigurationError(
            f"{options.first} and {options.second}: one is a campaign, the other is not",
            "compare two campaigns or two runs",
        )
    if options.variant:
        raise ConfigurationError("--variant with runs", "runs have no variants")
    difference, names = _runs(options)
    if options.json:
        print_json({"first": names[0], "second": names[1], **asdict(difference)})
    else:
        _print_runs(difference, names)
    return 0


def _campaign(name: str, options: argparse.Namespace) -> Path | None:
    """Return the folder of a campaign that is given as a path or as a name in the logs; None if it is not a
    campaign."""
    for path in (Path(name), logs_directory(options.logs) / name):
        if is_campaign(path):
            return path.absolute()
    return None


def _campaigns(a: CampaignFolder, b: CampaignFolder, options: argparse.Namespace) -> int:
    first, second = _by_variant(a), _by_variant(b)
    pairs = [(name, name) for name in first if name in second]
    if options.variant:
        pairs = [(options.variant, options.variant)]
        missing = [c.path.name for c, has in ((a, first), (b, second)) if options.variant not in has]
        if missing:
            raise ConfigurationError(
                f"{', '.join(missing)} has no variant '{options.variant}'", "see campaign.html"
            )
    elif not pairs and len(first) == len(second) == 1:
        pairs = [(next(iter(first)), next(iter(second)))]
    if not pairs:
        raise ConfigurationError("the campaigns have no variant in common", "name one with --variant")
    compared = {x: compare_trials(first[x], second[y]) for x, y in pairs}
    if options.json:
        print_json(
            {"first": str(a.path), "second": str(b.path), "variants": {k: asdict(c) for k, c in compared.items()}}
        )
        return 0
    print(f"A  {a.path.name}, begun {a.campaign.begun}\nB  {b.path.name}, begun {b.campaign.begun}")
    changed = changed_versions(a.campaign.program, b.campaign.program)
    if changed:
        print(f"program: {'; '.join(changed)}")
    for name, comparison in compared.items():
        _print_comparison(name, comparison)
    return 0


def _by_variant(campaign: CampaignFolder) -> dict[str, list[Trial]]:
    groups: dict[str, list[Trial]] = {}
    for trial in campaign.finished():
        groups.setdefault(trial.request.variant, []).append(trial)
    return groups


def _print_comparison(name: str, c: Comparison) -> None:
    print(
        f"\n{name}: {c.pairs} pairs of the same garment and seed"
        + (f", {c.unpaired} unpaired" if c.unpaired else "")
    )
    alone = f"by A alone {len(c.only_first)}, by B alone {len(c.only_second)}"
    print(f"  folded by both {c.both}, by neither {c.neither}, {alone}")
    print(f"  p = {c.p_value:.3f} (McNemar, exact)")
    print(f"  robot time   {difference('robot_time_s', c.robot_time_difference_s, c.robot_time_interval_s)}")
    print(f"  height       {difference('height_m', c.height_difference_m, c.height_interval_m)}")
    print("  both: median of B - A, with its bootstrap interval")
    for group, pairs, causes in (("A", c.only_first, c.second_causes), ("B", c.only_second, c.first_causes)):
        if pairs:
            print(
                f"  by {group} alone: "
                + ", ".join(f"{garment_name(garment)} seed {seed}" for garment, seed in pairs)
            )
            print("    the other's causes: " + ", ".join(f"{cause} ({n})" for cause, n in causes.items()))


def _runs(options: argparse.Namespace) -> tuple[RunDifference, tuple[str, str]]:
    found = []
    for name in (options.first, options.second):
        folder = Path(name).absolute()
        logs = (
            folder.parent
            if journal_path(folder.parent).is_file() and folder.is_dir()
            else logs_directory(options.logs)
        )
        with Journal.open(journal_path(logs), readonly=True) as journal:
            record = journal.run(name)
            found.append((record, journal.entries(record.id)))
    (a, a_entries), (b, b_entries) = found
    return run_difference(a, a_entries, b, b_entries), (a.id, b.id)


def _print_runs(difference: RunDifference, names: tuple[str, str]) -> None:
    print(f"A  {names[0]}\nB  {names[1]}")
    for title, rows in (("settings", difference.settings), ("versions", difference.versions)):
        _print_differences(title, rows)
    print("\ndecisions")
    if difference.then is None:
        print(f"  all {difference.alike} are the same")
    else:
        a, b = difference.then
        print(f"  the first {difference.alike} are the same, then")
        print(f"  A  {a or 'the run has ended'}\n  B  {b or 'the run has ended'}")
    _print_differences("figures", difference.figures)


def _print_differences(title: str, rows: tuple[Difference, ...]) -> None:
    print(f"\n{title}")
    if not rows:
        print("  the same")
        return
    print_table(
        ("", "A", "B"),
        [(f"  {d.name}", value_in_words(d.first, 60) or "-", value_in_words(d.second, 60) or "-") for d in rows],
    )
