"""Summarise a campaign: one row per variant and garment, claims against the scorer's verdicts, causes of
failure."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from foldcell.cell.campaigns.statistics.proportions import bootstrap_median, wilson_interval
from foldcell.cell.campaigns.trials.trial import Trial

ALL = "all"
PARTS = ("shape", "flat")
"""Parts of a claim and of the scorer's verdict."""
HOUR_S = 3600.0


@dataclass(frozen=True)
class Claims:
    """Numbers of scored runs by claim and verdict. Claimed: the executive ended the run as folded. Passed: the
    scorer found a good fold."""

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
    return _counted((t.claimed, t.passed) for t in trials if t.passed is not None)


def part_claims(trials: Sequence[Trial]) -> dict[str, Claims]:
    """Count each part of the claims against the same part of the verdict, over the runs in which both are known.
    Parts that no run has are left out."""
    found = {part: [pair for t in trials if (pair := _part(t, part)) is not None] for part in PARTS}
    return {part: _counted(pairs) for part, pairs in found.items() if pairs}


def _part(trial: Trial, name: str) -> tuple[bool, bool] | None:
    """Return a part of the claim and the scorer's verdict on it. None if the last fold was not inspected, or if
    the score does not judge this part."""
    claim, score = trial.record and trial.record.claim, trial.score
    if claim is None or score is None or getattr(score, name) is None:
        return None
    return bool(getattr(claim, name)), bool(getattr(score, name))


def _counted(pairs: Iterable[tuple[bool, bool | None]]) -> Claims:
    """Count pairs (claimed, passed)."""
    count = Counter(pairs)
    return Claims(count[True, True], count[True, False], count[False, True], count[False, False])


def _row(variant: str, name: str, trials: Sequence[Trial]) -> Row:
    records = [t.record for t in trials if t.record]
    sound = [record for record in records if record.result != "fault"]
    scores = [record.score for record in sound if record.score]
    folded = sum(t.success for t in trials)
    spent = sum(record.robot_time_s for record in records)
    times = [record.robot_time_s for record in sound]
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
        wall_time_s=_median(record.wall_time_s for record in sound),
        iou=_median(score.iou for score in scores),
        height_m=_median(score.height_m for score in scores),
        recoveries=sum(len(fold.recoveries) for record in sound for fold in record.steps),
        folds_per_hour=HOUR_S * folded / spent if spent > 0.0 else None,
        causes=dict(Counter(t.cause for t in trials if t.cause).most_common()),
    )


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return statistics.median(known) if known else None


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
