"""Tare of the tactile sensors: measures the bias of cells and tips without load, and the cells' noise.

Pressure cells drift with temperature. The bias is therefore measured immediately before each use, in the air
before a descent. Outliers among the readings are rejected. A single outlier of 3 N in one cell would raise the
noise estimate of all cells so much that cloth that loads a finger with 3 N would not be noticed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.live_pads import dead_pad
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.vocabulary import Array, Outcome, frozen, refuse, skill

TARE_READINGS = 12
"""Number of tactile readings averaged into the bias."""

OUTLIER_SIGMAS = 20.0
"""A reading that differs from its cell's median by more than this is an outlier, in standard deviations of the
noise of all cells together. The limit is high because the noise of single cells differs by factors of up to 5."""
NORMAL_DEVIATION = 1.4826
"""Ratio of standard deviation to median absolute deviation of normally distributed values."""
MIN_NOISE = 0.002
"""Minimum assumed noise of a cell [N]."""


@dataclass(frozen=True, eq=False)
class TactileBias:
    """Mean readings of the unloaded sensors.

    stamp: of the last reading [s]. cells: (2, rows, columns), tip: (2,) [N]. cell_noise: standard deviation of one
    reading of one cell [N].
    """

    stamp: float
    cells: Array
    tip: Array
    cell_noise: float

    def pads(self, reading: HandReading) -> Array:
        """Force (2,) on the two pads in a reading, less the bias [N]."""
        return np.asarray((reading.tactile.cells - self.cells).sum(axis=(1, 2)))

    @property
    def pad_noise(self) -> float:
        """Standard deviation of one reading of a pad's sum [N]."""
        return self.cell_noise * float(np.sqrt(self.cells[0].size))


@dataclass(frozen=True, eq=False)
class LoadedReadings:
    """State of a check: the readings since it began. bias: from the tare before the grasp. stamp: of the latest
    reading [s]. pads: (2,) forces on both pads, for each reading [N]; openings: of the pads, for each reading
    [m]."""

    settings: GraspSettings
    bias: TactileBias
    stamp: float = field(default=-np.inf, kw_only=True)
    pads: tuple[Array, ...] = field(default=(), kw_only=True)
    openings: tuple[float, ...] = field(default=(), kw_only=True)

    def after(self, reading: HandReading) -> Self:
        """Return the state with a reading, or the same state if the sensor has sent none since the last tick."""
        if reading.tactile.stamp <= self.stamp:
            return self
        return replace(
            self,
            stamp=reading.tactile.stamp,
            pads=(*self.pads, self.bias.pads(reading)),
            openings=(*self.openings, reading.gripper.opening),
        )


@dataclass(frozen=True, eq=False)
class TareState:
    settings: GraspSettings
    stamp: float = -np.inf
    cells: tuple[Array, ...] = ()
    tips: tuple[Array, ...] = ()
    outliers: int = 0
    """Number of outliers rejected so far."""


@skill
def tare(reading: HandReading, state: TareState) -> TareState | Outcome[TactileBias]:
    """Process the reading of one tick, with the pads open and unloaded.

    Further readings replace rejected outliers, at most `TARE_READINGS` of them.

    Failures: TACTILE_FAULT for a pad or a fingertip whose readings are constant, those of `validate_reading`.
    """
    refuse(validate_reading(reading))
    if reading.tactile.stamp <= state.stamp:
        return state
    cells, tips = (*state.cells, reading.tactile.cells), (*state.tips, reading.tactile.tip)
    required = TARE_READINGS
    if len(cells) < required:
        return replace(state, stamp=reading.tactile.stamp, cells=cells, tips=tips)
    stack, side = np.array(cells), reading.tactile.side
    refuse(dead_pad(side, stack, state.settings) or dead_pad(side, np.array(tips), state.settings, "fingertip"))
    inliers = ~(_is_outlier(stack) | _is_outlier(np.array(tips)))
    outliers = state.outliers + int(np.count_nonzero(~inliers))
    if not inliers.all() and outliers <= required:
        kept = np.flatnonzero(inliers)
        return TareState(
            state.settings,
            reading.tactile.stamp,
            tuple(cells[i] for i in kept),
            tuple(tips[i] for i in kept),
            outliers,
        )
    noise = float(np.sqrt(stack.var(axis=0, ddof=1).mean()))
    return Outcome(
        TactileBias(reading.tactile.stamp, frozen(stack.mean(axis=0)), frozen(np.mean(tips, axis=0)), noise)
    )


def _is_outlier(readings: Array) -> NDArray[np.bool_]:
    """Return (n,) whether any value of each of n readings (n, ...) [N] is far from the median of this value,
    relative to the noise of all values."""
    deviation = np.abs(readings - np.median(readings, axis=0)).reshape(len(readings), -1)
    noise = max(NORMAL_DEVIATION * float(np.median(deviation)), MIN_NOISE)
    return np.asarray((deviation > OUTLIER_SIGMAS * noise).any(axis=1))
