"""The pads' zero: what the cells and tips read with nothing on them.

Pressure cells drift with temperature, so a zero is taken right before each use: in the air before a descent,
and it says how noisy the cells are today. A reading that leaps out of the others is left out: a single one of 3 N
in one cell would make all cells pass for so noisy that cloth of 3 N on a finger goes unnoticed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skills.grasping.hand_reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.vocabulary import Array, Outcome, frozen

__all__ = ["TactileBias", "TareState", "start_tare", "tare"]

LEAP = 20.0
"""Standard deviations from its median at which a cell's reading leaps: cells differ in noise by up to 5."""
NORMAL_DEVIATION = 1.4826
"""Standard deviation of normal values over the median of their distances from the median."""
LEAST_NOISE = 0.002
"""That a cell is taken to have at least [N]."""


@dataclass(frozen=True, eq=False)
class TactileBias:
    """stamp: of the last reading in it [s]. cells: (2, rows, columns), tip: (2,) [N]. cell_noise: standard
    deviation of one reading of one cell [N]."""

    stamp: float
    cells: Array
    tip: Array
    cell_noise: float

    def pads(self, reading: HandReading) -> Array:
        """(2,) force on each pad over its zero [N]."""
        return np.asarray((reading.tactile.cells - self.cells).sum(axis=(1, 2)))

    @property
    def pad_noise(self) -> float:
        """Standard deviation of one reading of a pad's sum [N]."""
        return self.cell_noise * float(np.sqrt(self.cells[0].size))


@dataclass(frozen=True, eq=False)
class TareState:
    settings: GraspSettings
    stamp: float = -np.inf
    cells: tuple[Array, ...] = ()
    tips: tuple[Array, ...] = ()
    left_out: int = 0
    """Readings that leapt, so far."""


def start_tare(settings: GraspSettings) -> TareState:
    return TareState(settings)


def tare(reading: HandReading, state: TareState) -> TareState | Outcome[TactileBias]:
    """Gather readings of open, unloaded pads, in place of those that leap further ones, as many again at most.
    Fails as `fault` says."""
    bad = fault(reading, state.settings)
    if bad:
        return Outcome(failure=bad)
    if reading.tactile.stamp <= state.stamp:
        return state
    cells, tips = (*state.cells, reading.tactile.cells), (*state.tips, reading.tactile.tip)
    wanted = state.settings.zero_readings
    if len(cells) < wanted:
        return replace(state, stamp=reading.tactile.stamp, cells=cells, tips=tips)
    stack = np.array(cells)
    calm = ~(_leaps(stack) | _leaps(np.array(tips)))
    left_out = state.left_out + int(np.count_nonzero(~calm))
    if not calm.all() and left_out <= wanted:
        kept = np.flatnonzero(calm)
        return TareState(
            state.settings,
            reading.tactile.stamp,
            tuple(cells[i] for i in kept),
            tuple(tips[i] for i in kept),
            left_out,
        )
    noise = float(np.sqrt(stack.var(axis=0, ddof=1).mean()))
    return Outcome(
        TactileBias(reading.tactile.stamp, frozen(stack.mean(axis=0)), frozen(np.mean(tips, axis=0)), noise)
    )


def _leaps(readings: Array) -> NDArray[np.bool_]:
    """(n,) whether any figure of a reading (n, ...) [N] is far from its median, by their common noise."""
    off = np.abs(readings - np.median(readings, axis=0)).reshape(len(readings), -1)
    noise = max(NORMAL_DEVIATION * float(np.median(off)), LEAST_NOISE)
    return np.asarray((off > LEAP * noise).any(axis=1))
