"""Progress of a campaign: one line per finished run, with the time left."""

from __future__ import annotations

import time
from collections.abc import Callable

from foldcell.cell.campaigns.trials.campaign import DEFAULT_VARIANT
from foldcell.cell.campaigns.trials.trial import Trial
from foldcell.cell.record.words import garment_name


def described(trial: Trial) -> str:
    """Return the result and the times of a run, or its error."""
    record, request = trial.record, trial.request
    name = garment_name(request.garment)
    if request.variant != DEFAULT_VARIANT:
        name = f"{request.variant} {name}"
    verdict = f"{name:<24} seed {request.seed:<5} {trial.verdict:<14}"
    if record is None:
        return f"{verdict}  {trial.error}"
    return f"{verdict}  {record.robot_time_s:6.1f} s robot, {record.wall_time_s:6.1f} s wall"


class CampaignProgress:
    """Formats the progress of a campaign. total: number of runs; finished: number of runs that were made earlier;
    workers: number of runs performed in parallel. describe: returns the text about one run."""

    def __init__(
        self, total: int, finished: int, workers: int, describe: Callable[[Trial], str] = described
    ) -> None:
        self._total, self._finished, self._workers, self._describe = total, finished, workers, describe
        self._began, self._done = time.monotonic(), 0

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
        left = (time.monotonic() - self._began) / self._done * runs
        minutes = round(left / 60.0)
        if left < 90.0:
            return f"  {left:.0f} s left"
        return f"  {minutes} min left" if minutes < 90 else f"  {minutes // 60} h {minutes % 60:02d} min left"
