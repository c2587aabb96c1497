"""Judges ideal and spoiled folds of all shipped garments by the claim, and writes docs/results/claim.md.

    python -m benchmarks.claim_matrix [GARMENT...] [--seeds 9101 9102 ...] [--cache DIR] [--workers 2]

The folds are those of `benchmarks.score_matrix`, two variants of each kind, in other drawn fabrics. The
executive sees them through the simulated camera alone. A claim is false if it holds although the score fails
the fold. Pictures stay in the folder `--cache`, so that an interrupted command goes on where it was, and
another way to judge folds costs no new pictures.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path

from benchmarks.claims.record import recorded
from benchmarks.claims.verdicts import Verdict, caught_by, verdicts
from benchmarks.results_page import made_by, table
from benchmarks.score_matrix import KINDS, OTHER_KINDS
from foldcell.cell.campaigns.statistics.proportions import wilson_interval
from foldcell.cell.config.garments.garment_file import list_garments
from foldcell.robots.errors import CellError

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "claim.md"
CACHE = Path.home() / ".cache" / "foldcell" / "claims"
SEEDS = tuple(range(9101, 9109))
LOOKED_AT = frozenset(range(9101, 9105))
"""Seeds whose pictures were looked at while the inspection was developed."""


def judged(case: tuple[int, str], cache: Path) -> tuple[str, int, list[Verdict] | str]:
    """Judge all folds of a garment in one fabric. Returns the verdicts, or the reason why there are none."""
    seed, name = case
    try:
        return name, seed, list(verdicts(recorded(name, seed, cache)))
    except CellError as e:
        return name, seed, e.what


def all_judged(
    cases: Sequence[tuple[int, str]], cache: Path, workers: int
) -> Iterator[tuple[str, int, list[Verdict] | str]]:
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(partial(judged, cache=cache), cases)


def false_claims(found: Sequence[Verdict]) -> list[Verdict]:
    """Return the folds that fail the score and are claimed."""
    return [v for v in found if v.claimed and not v.good]


def page(found: Sequence[Verdict], unseen: Sequence[str], command: str) -> str:
    """Write the results page. unseen: garments that the executive could not fold up to the last picture."""
    ideal = [v for v in found if v.kind == "ideal" and v.good]
    spoiled = [v for v in found if v.kind in KINDS and not v.good]
    missed = [v for v in ideal if not v.claimed]
    seeds = sorted({v.seed for v in found})
    kinds = [(kind, [v for v in found if v.kind == kind and not v.good]) for kind in (*KINDS, *OTHER_KINDS)]
    kind_rows = [[kind, *_share(vs), _caught(vs)] for kind, vs in kinds]
    garment_rows = []
    for name in sorted({v.garment for v in found}):
        of_kind = [[v for v in spoiled if (v.garment, v.kind) == (name, kind)] for kind in KINDS]
        own = [v for v in ideal if v.garment == name]
        cells = [f"{len(false_claims(vs))} of {len(vs)}" for vs in of_kind]
        garment_rows.append([name, f"{sum(not v.claimed for v in own)} of {len(own)}", *cells])
    lines = [
        "# Results: ideal and spoiled folds under the claim",
        "",
        "Simulated. The spoiled folds are those of [the score's results](score.md), two variants of each",
        "kind, in other drawn fabrics and outlines. The executive sees them with the simulated camera, as it",
        "sees the folds of a run: it looks at the empty table and the flat garment, recognises it, plans,",
        "chooses trajectories, and predicts their outcome with the nominal fabric. Each fold before the last",
        "one is the ideal fold. Then the last fold is shown, ideal or spoiled, and judged once, without",
        "pressing. The claim is false if it holds although the score fails the fold. Intervals: Wilson, 95 %.",
        "",
        *(f"- {kind.replace('_', ' ')}: {about}" for kind, about in (KINDS | OTHER_KINDS).items()),
        "",
        made_by(command),
        f"Seeds: {', '.join(map(str, seeds))}.",
        *_looked_at(seeds),
        "",
        f"- False claims: {', '.join(_share(spoiled))}.",
        f"- Ideal folds not claimed: {len(missed)} of {len(ideal)}, {_interval(len(missed), len(ideal))}.",
        *(f"- Not judged: {text}." for text in unseen),
        "",
        table("Kinds", ("kind", "claimed good", "interval", "found by"), kind_rows),
        "",
        "A fold can be found by several figures. A sag in the middle is not counted above, because the score",
        "itself finds it in some garments only.",
        "",
        table("Garments", ("garment", "ideal, not claimed", *KINDS), garment_rows),
        "",
        *_listed("False claims", false_claims(found), lambda v: f"fails {', '.join(v.bad)}; {v.says}"),
        *_listed("Ideal folds that are not claimed", missed, lambda v: v.says),
    ]
    return "\n".join(lines)


def _looked_at(seeds: Sequence[int]) -> tuple[str, ...]:
    known = [str(seed) for seed in seeds if seed in LOOKED_AT]
    return (f"Looked at while the inspection was developed: seeds {', '.join(known)}.",) if known else ()


def _share(folds: Sequence[Verdict]) -> tuple[str, str]:
    claimed = len(false_claims(folds))
    return f"{claimed} of {len(folds)}", _interval(claimed, len(folds))


def _interval(count: int, total: int) -> str:
    low, high = wilson_interval(count, total) if total else (0.0, 1.0)
    return f"{100.0 * low:.1f} to {100.0 * high:.1f} %"


def _caught(folds: Sequence[Verdict]) -> str:
    counted = Counter(name for v in folds for name in caught_by(v))
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counted.most_common())


def _listed(title: str, folds: Sequence[Verdict], about: Callable[[Verdict], str]) -> list[str]:
    texts = [f"- {v.garment} {v.seed}, {v.kind.replace('_', ' ')} {v.variant}: {about(v)}" for v in folds]
    return [f"## {title}", "", *(texts or ["None."]), ""]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("garments", nargs="*", help="names; default: all that ship")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS), help="each draws another fabric")
    parser.add_argument("--cache", type=Path, default=CACHE, help=f"folder of pictures and ideal folds ({CACHE})")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--page", type=Path, default=PAGE, help="the results page")
    options = parser.parse_args()
    cases = list(product(options.seeds, options.garments or list_garments()))
    found: list[Verdict] = []
    unseen: list[str] = []
    for done, (name, seed, judged_folds) in enumerate(all_judged(cases, options.cache, options.workers), 1):
        told = judged_folds
        if isinstance(judged_folds, str):
            unseen.append(f"{name} {seed}: {judged_folds}")
        else:
            found += judged_folds
            lost = sum(v.good and v.kind == "ideal" and not v.claimed for v in judged_folds)
            told = f"{len(false_claims(judged_folds))} false claims, {lost} ideal folds not claimed"
        print(f"{done}/{len(cases)} {name} {seed}: {told}", flush=True)
    named = "".join(f" {name}" for name in options.garments)
    command = f"python -m benchmarks.claim_matrix{named} --seeds {' '.join(map(str, options.seeds))}"
    options.page.write_text(page(found, unseen, command), encoding="utf-8")
    print(options.page)


if __name__ == "__main__":
    main()
