"""Compare two variants or campaigns in pairs of runs with the same garment and seed."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from foldcell.cell.campaigns.statistics.proportions import bootstrap_median, mcnemar_exact
from foldcell.cell.campaigns.trials.trial import Trial

Pair = tuple[Trial, Trial]


@dataclass(frozen=True)
class Comparison:
    """Comparison of two groups of runs, the second with the first, over the `pairs` (garment, seed) that both
    have.

    both, neither: number of pairs in which both runs or neither run succeeded. only_first, only_second: (garment,
    seed) of the pairs in which only the run of that group succeeded; p_value: McNemar's exact test. unpaired:
    number of runs without a partner. Each field with `difference` in its name is the median of second minus first,
    over the pairs without a fault. The field after it is the 95 % bootstrap interval of this median.
    """

    pairs: int
    unpaired: int
    both: int
    neither: int
    only_first: tuple[tuple[str, int], ...]
    only_second: tuple[tuple[str, int], ...]
    p_value: float
    robot_time_difference_s: float | None
    robot_time_interval_s: tuple[float, float] | None
    height_difference_m: float | None
    height_interval_m: tuple[float, float] | None
    first_causes: Mapping[str, int]
    """Cause of failure -> number of runs, for the runs of the first group that failed while their partner
    succeeded."""
    second_causes: Mapping[str, int]


def compare_trials(first: Iterable[Trial], second: Iterable[Trial]) -> Comparison:
    """Compare the performed runs of two groups. A group has at most one run per garment and seed."""
    a, b = _by_pair(first), _by_pair(second)
    pairs = [(a[key], b[key]) for key in a if key in b]
    only_first = [(x, y) for x, y in pairs if x.success and not y.success]
    only_second = [(x, y) for x, y in pairs if y.success and not x.success]
    sound = [(x, y) for x, y in pairs if "fault" not in (x.result, y.result)]
    times = _differences(sound, lambda t: t.record.robot_time_s if t.record else None)
    heights = _differences(sound, lambda t: t.height_m)
    return Comparison(
        pairs=len(pairs),
        unpaired=len(a) + len(b) - 2 * len(pairs),
        both=sum(x.success and y.success for x, y in pairs),
        neither=sum(not x.success and not y.success for x, y in pairs),
        only_first=tuple(_named(x) for x, _ in only_first),
        only_second=tuple(_named(x) for x, _ in only_second),
        p_value=mcnemar_exact(len(only_first), len(only_second)),
        robot_time_difference_s=statistics.median(times) if times else None,
        robot_time_interval_s=bootstrap_median(times),
        height_difference_m=statistics.median(heights) if heights else None,
        height_interval_m=bootstrap_median(heights),
        first_causes=Counter(x.cause for x, _ in only_second),
        second_causes=Counter(y.cause for _, y in only_first),
    )


def _by_pair(trials: Iterable[Trial]) -> dict[tuple[str, int], Trial]:
    return {_named(t): t for t in trials if t.performed}


def _named(trial: Trial) -> tuple[str, int]:
    return trial.request.garment, trial.request.seed


def _differences(pairs: Sequence[Pair], figure: Callable[[Trial], float | None]) -> list[float]:
    values = [(figure(x), figure(y)) for x, y in pairs]
    return [y - x for x, y in values if x is not None and y is not None]
