"""Campaigns: runs of the same garments over many seeds, and their statistics.

The runs go to any `concurrent.futures` executor. A run depends only on its request, so the order in which runs end
does not matter.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from dataclasses import dataclass
from typing import Any

__all__ = ["GarmentFigures", "Trial", "run_trials", "tabulate", "wilson_interval"]


@dataclass(frozen=True)
class Trial:
    """One run of a campaign. figures: output of `foldcell fold --json`; error: reason why there are no figures.
    performed: False for a run that did not start or did not end because a worker process died."""

    garment: str
    seed: int
    figures: dict[str, Any] | None
    error: str = ""
    performed: bool = True

    @property
    def result(self) -> str:
        if not self.performed:
            return "not_performed"
        return str(self.figures.get("result")) if self.figures else "fault"

    @property
    def success(self) -> bool:
        """Whether the scorer passed the fold. Without a scorer: whether the cell claims that it folded."""
        if self.figures is None or self.result != "folded":
            return False
        score = self.figures.get("score")
        return bool(score.get("passed")) if score else True


@dataclass(frozen=True)
class GarmentFigures:
    """One row of the table. interval: Wilson interval, 95 %. Times are medians over the runs without faults
    [s]."""

    garment: str
    runs: int
    folded: int
    interval: tuple[float, float]
    false_claims: int
    """Runs that claimed `folded` although the scorer did not pass them."""
    faults: int
    robot_time_s: float | None
    wall_time_s: float | None
    iou: float | None
    recoveries: int


def run_trials(
    work: Callable[[str, int], dict[str, Any]], garments: Sequence[str], seeds: Sequence[int], executor: Executor
) -> Generator[Trial, None, None]:
    """Yield each trial as it ends. `work(garment, seed)` returns the figures of a run; an exception counts as a
    fault. A run whose worker process is killed counts as not performed."""
    jobs = {executor.submit(work, g, s): (g, s) for g in garments for s in seeds}
    try:
        for job in as_completed(jobs):
            garment, seed = jobs[job]
            error = job.exception()
            if error is None:
                yield Trial(garment, seed, job.result())
            else:
                text = f"{type(error).__name__}: {error}"
                yield Trial(garment, seed, None, text, not isinstance(error, BrokenExecutor))
    finally:
        for job in jobs:
            job.cancel()


def tabulate(trials: Iterable[Trial]) -> list[GarmentFigures]:
    """One row per garment, sorted by name, then one row for all garments. Only performed runs count."""
    by_garment: dict[str, list[Trial]] = {}
    for trial in (t for t in trials if t.performed):
        by_garment.setdefault(trial.garment, []).append(trial)
    rows = [_row(name, by_garment[name]) for name in sorted(by_garment)]
    if len(rows) > 1:
        rows.append(_row("all", [t for group in by_garment.values() for t in group]))
    return rows


def wilson_interval(successes: int, runs: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Confidence interval of a proportion (Wilson 1927). z: quantile of the normal distribution; the default gives
    95 %.

    Unlike the normal approximation, the interval is accurate near 0 and 1 and for few runs.
    """
    if not 0 <= successes <= runs:
        raise ValueError(f"{successes} of {runs}")
    if runs == 0:
        return 0.0, 1.0
    p, zz = successes / runs, z * z
    centre = (p + zz / (2 * runs)) / (1 + zz / runs)
    half = z / (1 + zz / runs) * math.sqrt(p * (1 - p) / runs + zz / (4 * runs * runs))
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == runs else min(1.0, centre + half)
    return low, high


def _row(name: str, trials: list[Trial]) -> GarmentFigures:
    figures = [t.figures for t in trials if t.figures is not None and t.result != "fault"]
    folded = sum(t.success for t in trials)
    scores = [f["score"] for f in figures if f.get("score")]
    steps = [step for f in figures for step in f.get("steps") or []]
    return GarmentFigures(
        garment=name,
        runs=len(trials),
        folded=folded,
        interval=wilson_interval(folded, len(trials)),
        false_claims=sum(t.result == "folded" and not t.success for t in trials),
        faults=sum(t.result == "fault" for t in trials),
        robot_time_s=_median(f.get("robot_time_s") for f in figures),
        wall_time_s=_median(f.get("wall_time_s") for f in figures),
        iou=_median(s.get("iou") for s in scores),
        recoveries=sum(_count(step.get("recoveries")) for step in steps),
    )


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return statistics.median(known) if known else None


def _count(recoveries: object) -> int:
    """Number of recoveries of a step. Figures hold it as a number or as a list of recoveries."""
    if isinstance(recoveries, int):
        return recoveries
    return len(recoveries) if isinstance(recoveries, list | tuple) else 0
