"""`foldcell compare`: compares two campaigns on the same garments and seeds, or two runs."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from foldcell.cell.campaigns.statistics.comparison import Comparison, compare_trials
from foldcell.cell.campaigns.trials.store import CampaignFolder, changed_versions, is_campaign
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.commands.shared import answer, logs_option, table
from foldcell.cell.journal.journal import Journal
from foldcell.cell.record.words import difference, garment_name, value_in_words
from foldcell.cell.runs.run_difference import Difference, RunDifference, run_difference
from foldcell.cell.support.files.paths import journal_path, logs_directory, logs_of_run
from foldcell.robots.errors import ConfigurationError


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first", metavar="A", help="a campaign's folder, or a run (id, folder or last)")
    parser.add_argument("second", metavar="B", help="another one, which is compared with the first")
    parser.add_argument(
        "--variant", metavar="NAME", help="the variant of both campaigns (every variant that both have)"
    )
    logs_option(parser)


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
    figures = {"first": names[0], "second": names[1], **asdict(difference)}
    return answer(options, figures, _lines_of_runs(difference, names))


def _campaign(name: str, options: argparse.Namespace) -> Path | None:
    """Return the folder of a campaign that is given as a path or as a name in the logs; None if it is not a
    campaign."""
    for path in (Path(name), logs_directory(options.logs) / name):
        if is_campaign(path):
            return path.absolute()
    return None


def _campaigns(a: CampaignFolder, b: CampaignFolder, options: argparse.Namespace) -> int:
    if a.campaign.attended != b.campaign.attended:
        raise ConfigurationError(
            f"a person judged {(a if a.campaign.attended else b).path.name}, and the scorer the other campaign",
            "compare campaigns with the same kind of verdict",
        )
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
    variants = {name: asdict(comparison) for name, comparison in compared.items()}
    lines = [
        f"{name}  {c.path.name}, {c.campaign.label}, begun {c.campaign.begun}" for name, c in (("A", a), ("B", b))
    ]
    changed = changed_versions(a.campaign.program, b.campaign.program)
    if changed:
        lines.append(f"program: {'; '.join(changed)}")
    for name, comparison in compared.items():
        lines += _lines_of_comparison(name, comparison)
    return answer(options, {"first": str(a.path), "second": str(b.path), "variants": variants}, lines)


def _by_variant(campaign: CampaignFolder) -> dict[str, list[Trial]]:
    groups: dict[str, list[Trial]] = {}
    for trial in campaign.finished():
        groups.setdefault(trial.request.variant, []).append(trial)
    return groups


def _lines_of_comparison(name: str, c: Comparison) -> Iterator[str]:
    unpaired = f", {c.unpaired} unpaired" if c.unpaired else ""
    yield f"\n{name}: {c.pairs} pairs of the same garment and seed{unpaired}"
    alone = f"by A alone {len(c.only_first)}, by B alone {len(c.only_second)}"
    yield f"  folded by both {c.both}, by neither {c.neither}, {alone}"
    yield f"  p = {c.p_value:.3f} (McNemar, exact)"
    yield f"  robot time   {difference('robot_time_s', c.robot_time_difference_s, c.robot_time_interval_s)}"
    yield f"  height       {difference('height_m', c.height_difference_m, c.height_interval_m)}"
    yield "  both: median of B - A, with its bootstrap interval"
    for group, pairs, causes in (("A", c.only_first, c.second_causes), ("B", c.only_second, c.first_causes)):
        if pairs:
            runs = ", ".join(f"{garment_name(garment)} seed {seed}" for garment, seed in pairs)
            yield f"  by {group} alone: {runs}"
            yield "    the other's causes: " + ", ".join(f"{cause} ({n})" for cause, n in causes.items())


def _runs(options: argparse.Namespace) -> tuple[RunDifference, tuple[str, str]]:
    found = []
    for name in (options.first, options.second):
        # a folder may be in other logs than the run with which it is compared
        logs = logs_of_run(name, None if os.sep in name else options.logs)
        with Journal.open(journal_path(logs), readonly=True) as journal:
            record = journal.run(name)
            found.append((record, journal.entries(record.id)))
    (a, a_entries), (b, b_entries) = found
    return run_difference(a, a_entries, b, b_entries), (a.id, b.id)


def _lines_of_runs(difference: RunDifference, names: tuple[str, str]) -> Iterator[str]:
    yield f"A  {names[0]}\nB  {names[1]}"
    for title, rows in (("settings", difference.settings), ("versions", difference.versions)):
        yield from _lines_of_values(title, rows)
    yield "\ndecisions"
    if difference.then is None:
        yield f"  all {difference.alike} are the same"
    else:
        a, b = difference.then
        yield f"  the first {difference.alike} are the same, then"
        yield f"  A  {a or 'the run has ended'}\n  B  {b or 'the run has ended'}"
    yield from _lines_of_values("figures", difference.figures)


def _lines_of_values(title: str, rows: tuple[Difference, ...]) -> list[str]:
    cells = [
        (f"  {d.name}", value_in_words(d.first, 60) or "-", value_in_words(d.second, 60) or "-") for d in rows
    ]
    return [f"\n{title}", *(table(("", "A", "B"), cells) if rows else ["  the same"])]
