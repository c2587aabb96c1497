"""The pads' zero: what the cells and tips read with nothing on them.

Pressure cells drift with temperature, so a zero is taken right before each use: in the air before a descent,
and it says how noisy the cells are today.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skills.grasping.reading import HandReading, fault
from skills.grasping.settings import GraspSettings
from skills.vocabulary import Array, Outcome, frozen

__all__ = ["Zero", "ZeroState", "start_zero", "zero"]


@dataclass(frozen=True, eq=False)
class Zero:
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
class ZeroState:
    settings: GraspSettings
    stamp: float = -np.inf
    cells: tuple[Array, ...] = ()
    tips: tuple[Array, ...] = ()


def start_zero(settings: GraspSettings) -> ZeroState:
    return ZeroState(settings)


def zero(reading: HandReading, state: ZeroState) -> ZeroState | Outcome[Zero]:
    """Gather readings of open, unloaded pads. Fails as `fault` says."""
    bad = fault(reading, state.settings)
    if bad:
        return Outcome(failure=bad)
    if reading.tactile.stamp <= state.stamp:
        return state
    cells, tips = (*state.cells, reading.tactile.cells), (*state.tips, reading.tactile.tip)
    if len(cells) < state.settings.zero_readings:
        return ZeroState(state.settings, reading.tactile.stamp, cells, tips)
    stack = np.array(cells)
    noise = float(np.sqrt(stack.var(axis=0, ddof=1).mean()))
    return Outcome(Zero(reading.tactile.stamp, frozen(stack.mean(axis=0)), frozen(np.mean(tips, axis=0)), noise))
