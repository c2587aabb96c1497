"""Progress of a campaign: one line per finished run, with the time left."""

from __future__ import annotations

import time
from collections.abc import Callable

from cell.campaigns.trials.trial import Trial

__all__ = ["CampaignProgress"]


class CampaignProgress:
    """Formats the progress of a campaign. total: number of runs; finished: number of runs that were made earlier;
    workers: number of runs performed in parallel. clock: returns the time [s]. describe: text about one run; None:
    its result and times."""

    def __init__(
        self,
        total: int,
        finished: int,
        workers: int,
        clock: Callable[[], float] = time.monotonic,
        describe: Callable[[Trial], str] | None = None,
    ) -> None:
        self._describe = describe or describe_trial
        self._total, self._finished, self._workers = total, finished, workers
        self._clock, self._began, self._done = clock, clock(), 0

    def line(self, trial: Trial) -> str:
        """Return the line for a run that has just finished."""
        self._done += 1
        count = self._finished + self._done
        return f"{count:4d}/{self._total}  {self._describe(trial)}{self._left(self._total - count)}"

    def _left(self, runs: int) -> str:
        """Return the text of the time left, from the mean time of the runs so far. Empty until as many runs have
        finished as there are workers."""
        if runs <= 0 or self._done < self._workers:
            return ""
        left = (self._clock() - self._began) / self._done * runs
        return f"  {duration(left)} left"


def describe_trial(trial: Trial) -> str:
    figures = trial.figures or {}
    times = f"  {figures.get('robot_time_s') or 0:6.1f} s robot, {figures.get('wall_time_s') or 0:6.1f} s wall"
    verdict = "folded" if trial.success else "false claim" if trial.claimed else trial.result
    name = (
        trial.request.garment
        if trial.request.variant == "shipped"
        else trial.request.variant + " " + trial.request.garment
    )
    return f"{name:<24} seed {trial.request.seed:<5} {verdict:<14}" + (times if figures else f"  {trial.error}")


def duration(seconds: float) -> str:
    """Format a time [s] as '40 s', '12 min' or '3 h 20 min'."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
