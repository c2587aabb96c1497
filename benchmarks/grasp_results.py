"""Writes docs/results/grasps.md from the journals of runs: how often the first grasp of a fold held.

    foldcell trials ...
    python -m benchmarks.grasp_results FOLDER ... --date YYYY-MM-DD --commit HASH

FOLDER: a campaign's folder, or any other that contains journals. They say how many layers each hand held (since
5a6ae05b). Only the first grasp of each fold counts, and only if it ended with cloth in the hands or with a failure
to hold it. A grasp that was lost in the lift did not hold.
"""

from __future__ import annotations

import argparse
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.results_page import table
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.journal.journal import Intent, Journal, performed
from foldcell.cell.record.words import interval, plain
from foldcell.cell.states.transition_table import Effect
from foldcell.robots.errors import FailureKind

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "grasps.md"
NOT_HELD = frozenset({FailureKind.MISSED_GRASP, FailureKind.MISSED_LAYER, FailureKind.NO_CONTACT})
BY_FOLD = ("garment", "fold", "held", "interval", "more")
ABOUT = """# Results: first grasps

Simulated. How often the first grasp of a fold held at least the planned layers, by the hands' own sensors: the
pads' opening and force after closing, and again after a lift of 30 mm. More layers, as in a pleat, count as held;
the last column counts the grasps in which a hand held more. Intervals: Wilson, 95 %.
"""


@dataclass(frozen=True)
class FirstGrasp:
    """The first grasp of a fold. tries: number of grasps of this fold, repairs included. what: why it did not
    hold; empty if it held. more: whether it held, and a hand held more layers than planned."""

    garment: str
    seed: int | None
    fold: str
    tries: int
    what: str = ""
    more: bool = False


def first_grasps(garment: str, seed: int | None, effects: Sequence[Intent]) -> Iterator[FirstGrasp]:
    """Return the first grasp of each fold of a run. Grasps that ended for another reason (a stop, a fault) are
    left out."""
    names: Sequence[str] = ()
    folds: dict[int, list[Intent]] = {}
    for effect in effects:
        if effect.name == Effect.PLAN_FOLDS and effect.result is not None:
            names = effect.result.payload.get("steps", names)
        if effect.name in (Effect.GRASP, Effect.LIFT) and effect.fold is not None:
            folds.setdefault(effect.fold, []).append(effect)
    for index, made in folds.items():
        grasp, *later = made
        lost = later[0] if later and later[0].name == Effect.LIFT and later[0].failure in NOT_HELD else None
        failed = grasp if grasp.failure else lost
        if grasp.result is None or (failed is not None and failed.failure not in NOT_HELD):
            continue
        tries = sum(effect.name == Effect.GRASP for effect in made)
        hands = [] if failed else grasp.result.payload["held"].values()
        more = any(hand["layers"] > hand["planned"] for hand in hands)
        yield FirstGrasp(garment, seed, names[index], tries, (failed.what or "") if failed else "", more)


def read_grasps(folder: Path) -> Iterator[FirstGrasp]:
    """Return the first grasps of all runs whose journals lie in a folder or below it."""
    for path in sorted(folder.rglob("journal.db")):
        with Journal.open(path, readonly=True, traceless=True) as journal:
            for run in journal.runs():
                yield from first_grasps(run.garment, run.seed, performed(journal.entries(run.id)))


def page(grasps: Sequence[FirstGrasp], about: str) -> str:
    """Return the page. about: when and how the runs were made."""
    groups: dict[tuple[str, str], list[FirstGrasp]] = {}
    for grasp in grasps:
        groups.setdefault((grasp.garment, grasp.fold), []).append(grasp)
    by_fold = [(plain(garment), plain(fold), *_share(group)) for (garment, fold), group in sorted(groups.items())]
    missed = [
        (plain(g.garment), str(g.seed), plain(g.fold), g.what.replace("|", "/"), str(g.tries))
        for g in grasps if g.what
    ]  # fmt: skip
    return "\n".join([
        ABOUT,
        about,
        "",
        table("By fold", BY_FOLD, [*by_fold, ("all", "", *_share(grasps))]),
        "",
        table("First grasps that did not hold", ("garment", "seed", "fold", "what was felt", "tries"), missed),
        "",
    ])  # fmt: skip


def _share(grasps: Sequence[FirstGrasp]) -> tuple[str, str, str]:
    held = sum(not g.what for g in grasps)
    return (
        f"{held} of {len(grasps)}",
        interval(wilson_interval(held, len(grasps))),
        str(sum(g.more for g in grasps)),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--date", required=True, metavar="YYYY-MM-DD", help="date of the runs")
    parser.add_argument("--commit", required=True, help="commit of the program that made the runs")
    options = parser.parse_args(arguments)
    grasps = [grasp for folder in options.folders for grasp in read_grasps(folder)]
    about = (
        f"{options.date}, commit {options.commit}, {platform.machine()}:\n"
        "`foldcell trials`, then `python -m benchmarks.grasp_results FOLDER ...`."
    )
    PAGE.write_text(page(grasps, about), encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
