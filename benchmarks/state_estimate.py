"""Measures how often the estimated state of a garment after an interrupted fold is right, and how far its
confidence can be trusted. Writes docs/results/state_estimate.md.

    python -m benchmarks.state_estimate [GARMENT:FOLD...] [--seeds 2] [--figures FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.interrupted_folds import WorldFold, open_fold, shoved
from benchmarks.perception.scenes import TABLE
from benchmarks.results_page import made_by, table
from benchmarks.shipped_settings import PERCEPTION
from foldcell.skills.state_estimate.estimate import StateEstimate, estimate_state
from foldcell.skills.state_estimate.hand_course import HandCourse
from foldcell.skills.state_estimate.hypothesis import FoldState, Interruption
from foldcell.skills.state_estimate.interrupted_fold import simulate_interruptions
from foldcell.skills.state_estimate.observation import observe
from foldcell.skills.vocabulary import Array, CameraFrame

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "state_estimate.md"
GARMENTS = ("t_shirt:0", "pants:0", "small_towel:0", "small_towel:1", "medium_towel:0")
"""Garments, each with the index of the interrupted fold."""
FIRST_SEED = 8101
BOUNDS = (0.0, 0.6, 0.8, 0.95, 0.99, 1.0)
"""Bounds of the classes of confidence for which the share of right estimates is stated."""

Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Case:
    """One picture of the world's garment. cause: what happened; share: of the motion's time, at which it
    happened."""

    cause: str
    share: float
    truth: FoldState
    frame: CameraFrame


def cases(fold: WorldFold, rng: np.random.Generator) -> Iterator[Case]:
    """Draw interrupted folds, each with its true state and picture."""
    hands = list(fold.paths)
    complete = fold.interrupted({})

    def pushed(x: Array) -> Array:
        return shoved(x, rng.uniform(0.0, 0.08), rng.uniform(-0.25, 0.25), rng.uniform(0.0, 2 * np.pi))

    def case(cause: str, share: float, x: Array, moved: bool = False) -> Case:
        truth = fold.true_state(x, complete)
        if cause == "dropped in a heap" and truth is FoldState.HALF_WAY:
            truth = FoldState.HEAP
        return Case(cause, share, truth, fold.shoot(pushed(x) if moved else x))

    yield case("not touched", 0.0, fold.at_start())
    yield case("shoved before the fold", 0.0, fold.at_start(), moved=True)
    yield case("completed", 1.0, complete)
    yield case("shoved after the fold", 1.0, complete, moved=True)
    for _ in range(3):
        share = float(rng.uniform(0.15, 0.85))
        yield case("hands opened", share, fold.interrupted({}, share), moved=bool(rng.random() < 0.3))
    if len(hands) == 2:
        for _ in range(3):
            hand, share = hands[int(rng.integers(2))], float(rng.uniform(0.15, 0.85))
            moved = bool(rng.random() < 0.3)
            yield case("one hand slipped", share, fold.interrupted({hand: share}), moved=moved)
        for _ in range(2):
            hand, share = hands[int(rng.integers(2))], float(rng.uniform(0.25, 0.75))
            late = share + float(rng.uniform(0.03, 0.2))
            yield case("one slipped, other opened", share, fold.interrupted({hand: share}, late))
        hand, share = hands[int(rng.integers(2))], float(rng.uniform(0.3, 0.7))
        yield case("one slipped, other laid back", share, fold.interrupted({hand: share}, share + 0.05, True))
    share = float(rng.uniform(0.3, 0.9))
    yield case("laid back", share, fold.interrupted({}, share, laid_back=True))
    for _ in range(2):
        yield case("dropped in a heap", 0.0, fold.heaped(rng))


def estimate(fold: WorldFold, frame: CameraFrame, course: HandCourse | None = None) -> StateEstimate | None:
    """Estimate the state in one picture; None if no garment can be judged in it. course: of the hands, if it was
    measured."""
    seen = observe(frame, fold.calibration, TABLE, fold.reference, settings=PERCEPTION)
    if seen.failure:
        return None

    def simulate(ways: Sequence[Interruption]) -> list[Array]:
        material = fold.garment.material
        return simulate_interruptions(
            fold.mesh, fold.before.vertices, material, fold.paths, ways, course=course
        )  # fmt: skip

    several_layers = any(grasp.layers > 1 for grasp in fold.step.grasps.values())
    return estimate_state(
        seen.unwrap(), fold.before, fold.after, list(fold.paths), simulate, fold.lift, several_layers,
        measured=course is not None,
    )  # fmt: skip


def rows(name: str, index: int, seed: int) -> Iterator[Row]:
    """Judge the drawn cases of one garment. Yields one row of plain values for each."""
    with open_fold(name, seed, index) as fold:
        for case in cases(fold, np.random.default_rng([seed, index, 29])):
            began = time.process_time()
            found = estimate(fold, case.frame)
            row = {
                "garment": name, "fold": index, "seed": seed, "cause": case.cause, "share": case.share,
                "truth": case.truth.value, "cpu_s": time.process_time() - began,
            }  # fmt: skip
            if found is None:
                yield row
                continue
            fits = [(f.hypothesis.state.value, f.misfit, f.cells, f.drift_m, f.drift_rad) for f in found.fits]
            yield {
                **row, "said": found.state.value, "confidence": found.confidence,
                "simulations": found.simulations, "fits": fits,
                "probabilities": {state.value: p for state, p in found.probabilities.items()},
            }  # fmt: skip


def page(found: Sequence[Row], command: str) -> str:
    """Write the results page from the rows."""
    judged = [row for row in found if "said" in row]
    right = [row["said"] == row["truth"] for row in judged]
    states = [state.value for state in FoldState]
    confusion = [
        [true, *(str(sum(r["truth"] == true and r["said"] == said for r in judged)) for said in states)]
        for true in states
    ]
    causes = list(dict.fromkeys(row["cause"] for row in judged))
    by_cause = [_share_right(cause, [r for r in judged if r["cause"] == cause]) for cause in causes]
    names = list(dict.fromkeys((row["garment"], row["fold"]) for row in judged))
    by_garment = [
        _share_right(
            f"{name}, fold {index + 1}", [r for r in judged if (r["garment"], r["fold"]) == (name, index)]
        )
        for name, index in names
    ]
    lines = [
        "# Results: the state of a garment after an interrupted fold",
        "",
        "Simulated. Folds of the simulated world (its outline, mesh, fabric and wrinkles are drawn by seed) are",
        "interrupted at drawn moments. Some garments are then shoved by up to 80 mm and 14 degrees. The estimate",
        "knows the pictures of the simulated camera, the predictor's mesh and the planned paths.",
        "",
        "True state: `before` or `after` if, after a rigid alignment, 98 % of the vertices of the world's garment",
        "lie within 30 mm of their places before the fold or after the completed fold; otherwise `heap` if the",
        "garment was lifted by one point and dropped, else `half_way`. Near these bounds, a right shape can count",
        "as a wrong state.",
        "",
        made_by(command),
        f"Right: {sum(right)} of {len(judged)}; pictures that could not be judged: {len(found) - len(judged)}.",
        f"Mean squared error of the probabilities (Brier score): {_brier(judged):.3f}.",
        f"CPU time per estimate: median {_median(judged, 'cpu_s'):.1f} s, largest "
        f"{max(r['cpu_s'] for r in judged):.1f} s.",
        "",
        table("True state (rows) and estimated state (columns)", ("", *states), confusion),
        "",
        table("By confidence", ("confidence", "estimates", "mean confidence", "right"), _calibration(judged)),
        "",
        table("By cause", ("cause", "estimates", "right", "mean confidence"), by_cause),
        "",
        table("By garment", ("garment", "estimates", "right", "mean confidence"), by_garment),
        "",
    ]
    return "\n".join(lines)


def _share_right(name: str, judged: Sequence[Row]) -> list[str]:
    right = sum(row["said"] == row["truth"] for row in judged)
    confidence = float(np.mean([row["confidence"] for row in judged]))
    return [name, str(len(judged)), str(right), f"{confidence:.2f}"]


def _calibration(judged: Sequence[Row]) -> list[list[str]]:
    """Return the rows of the table of confidence and share of right estimates."""
    cells = []
    for low, high in pairwise(BOUNDS):
        part = [r for r in judged if low <= r["confidence"] < high or (high == 1.0 == r["confidence"])]
        if part:
            _, count, right, confidence = _share_right("", part)
            cells.append([f"{low:g} to {high:g}", count, confidence, f"{int(right) / int(count):.2f}"])
    return cells


def _brier(judged: Sequence[Row]) -> float:
    """Mean over the estimates of the summed squared errors of the states' probabilities (Brier 1950)."""
    errors = [
        sum((p - (state == row["truth"])) ** 2 for state, p in row["probabilities"].items()) for row in judged
    ]
    return float(np.mean(errors))


def _median(judged: Sequence[Row], name: str) -> float:
    return float(np.median([row[name] for row in judged]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folds", nargs="*", default=GARMENTS, help="garment and index of the fold")
    parser.add_argument("--seeds", type=int, default=2, help="garments drawn for each fold (2)")
    parser.add_argument(
        "--figures", type=Path, help="file for the rows as JSON lines; rows in it are not repeated"
    )
    options = parser.parse_args()
    found: list[Row] = []
    if options.figures and options.figures.exists():
        found = [json.loads(line) for line in options.figures.read_text().splitlines()]
    known = {(row["garment"], row["fold"], row["seed"]) for row in found}
    for fold in options.folds:
        name, index = fold.split(":")
        for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
            if (name, int(index), seed) in known:
                continue
            new = []
            for row in rows(name, int(index), seed):
                new.append(row)
                shown = {key: value for key, value in row.items() if key not in {"fits", "probabilities"}}
                print(json.dumps(shown), flush=True)
            found += new
            if options.figures:
                options.figures.write_text("".join(json.dumps(row) + "\n" for row in found))
    named = "".join(f" {fold}" for fold in options.folds if options.folds is not GARMENTS)
    command = f"python -m benchmarks.state_estimate{named} --seeds {options.seeds}"
    PAGE.write_text(page(found, command), encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
