"""Summarise a campaign: one row per variant and garment, claims against the scorer's verdicts, causes of
failure."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cell.campaigns.statistics.proportions import bootstrap_median, wilson_interval
from cell.campaigns.trials.trial import Trial

__all__ = ["ALL", "PARTS", "Claims", "Row", "claims", "part_claims", "summarise"]

ALL = "all"
PARTS = ("shape", "flat")
"""Parts of a claim and of the scorer's verdict."""
HOUR_S = 3600.0


@dataclass(frozen=True)
class Claims:
    """Numbers of scored runs. Claimed: the executive ended the run as folded. Passed: the scorer found a good
    fold."""

    claimed_passed: int
    claimed_failed: int
    """Number of false claims."""
    unclaimed_passed: int
    """Number of good folds that the executive did not claim."""
    unclaimed_failed: int

    @property
    def precision(self) -> float | None:
        """Share of the claims that the scorer confirmed."""
        return _share(self.claimed_passed, self.claimed_passed + self.claimed_failed)

    @property
    def recall(self) -> float | None:
        """Share of the good folds that the executive claimed."""
        return _share(self.claimed_passed, self.claimed_passed + self.unclaimed_passed)


@dataclass(frozen=True)
class Row:
    """Figures of the runs of one variant and garment, or of all garments.

    folded: number of runs that were claimed and passed. interval: 95 % Wilson interval of the share of these runs.
    Times [s], iou and height_m are medians over the runs without faults. robot_time_interval_s: 95 % bootstrap
    interval. folds_per_hour: folded garments per hour of the cell's clock; the time of failed runs counts too.
    """

    variant: str
    garment: str
    runs: int
    folded: int
    interval: tuple[float, float]
    claimed: int
    false_claims: int
    faults: int
    robot_time_s: float | None
    robot_time_interval_s: tuple[float, float] | None
    wall_time_s: float | None
    iou: float | None
    height_m: float | None
    recoveries: int
    folds_per_hour: float | None
    causes: Mapping[str, int]


def summarise(trials: Iterable[Trial]) -> list[Row]:
    """Return, for each variant, one row per garment in order of name, and one row for all garments if there are
    several. Runs that were not performed do not count."""
    by_variant: dict[str, dict[str, list[Trial]]] = {}
    for trial in (t for t in trials if t.performed):
        by_variant.setdefault(trial.request.variant, {}).setdefault(trial.request.garment, []).append(trial)
    rows = []
    for variant, by_garment in by_variant.items():
        rows += [_row(variant, name, by_garment[name]) for name in sorted(by_garment)]
        if len(by_garment) > 1:
            rows.append(_row(variant, ALL, [t for group in by_garment.values() for t in group]))
    return rows


def claims(trials: Iterable[Trial]) -> Claims:
    """Count claims against verdicts, over the scored runs."""
    count = Counter((t.claimed, t.passed) for t in trials if t.passed is not None)
    return Claims(count[True, True], count[True, False], count[False, True], count[False, False])


def part_claims(trials: Iterable[Trial]) -> dict[str, Claims]:
    """Count each part of the claims against the same part of the verdict: part -> numbers of the runs in which
    both are known. Parts that no run has are left out."""
    found = {}
    all_trials = list(trials)
    for name in PARTS:
        count = Counter(pair for t in all_trials if (pair := t.part(name)) is not None)
        if count:
            found[name] = Claims(count[True, True], count[True, False], count[False, True], count[False, False])
    return found


def _row(variant: str, name: str, trials: Sequence[Trial]) -> Row:
    figures = [t.figures for t in trials if t.figures is not None and t.result != "fault"]
    folded = sum(t.success for t in trials)
    scores = [f["score"] for f in figures if f.get("score")]
    steps = [step for f in figures for step in f.get("steps") or []]
    times = [f["robot_time_s"] for f in figures if f.get("robot_time_s") is not None]
    spent = sum(t.figures.get("robot_time_s") or 0.0 for t in trials if t.figures is not None)
    return Row(
        variant=variant,
        garment=name,
        runs=len(trials),
        folded=folded,
        interval=wilson_interval(folded, len(trials)),
        claimed=sum(t.claimed for t in trials),
        false_claims=sum(t.claimed and not t.success for t in trials),
        faults=sum(t.result == "fault" for t in trials),
        robot_time_s=_median(times),
        robot_time_interval_s=bootstrap_median(times),
        wall_time_s=_median(f.get("wall_time_s") for f in figures),
        iou=_median(s.get("iou") for s in scores),
        height_m=_median(s.get("height_m") for s in scores),
        recoveries=sum(_count(step.get("recoveries")) for step in steps),
        folds_per_hour=HOUR_S * folded / spent if spent > 0.0 else None,
        causes=dict(Counter(t.cause for t in trials if t.cause).most_common()),
    )


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return statistics.median(known) if known else None


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _count(recoveries: object) -> int:
    """Return the number of recoveries of a step. They are given as a number or as a list."""
    if isinstance(recoveries, int):
        return recoveries
    return len(recoveries) if isinstance(recoveries, list | tuple) else 0
