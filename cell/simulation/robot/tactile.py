"""The simulated tactile sensors of one gripper: pressure cells on each pad, and the force on each fingertip."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from foldcell.cell.simulation.noise import TactileNoise
from foldcell.robots.ports import Array, Side, TactileReading, frozen

DRIFT_PERIOD = 120.0  # [s]
SPREAD = 0.006  # width of the pressure peak along the pad [m]
HELD_DEPTH = 0.006  # height of the pressure peak above the tips: the pads hold the cloth there [m]


class SimulatedTactile:
    """The sensors sample at a fixed rate. Readings within one sample period are identical.

    pressing(): force on each pad [N]; tips(): forces on the two fingertips (2,) [N]; clinging(): force of cloth
    that hangs on the finger of pad 0 [N].
    """

    def __init__(
        self,
        side: Side,
        noise: TactileNoise,
        seed: int,
        ideal: bool,
        pressing: Callable[[], float],
        tips: Callable[[], Array],
        clinging: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.side = side
        self._noise, self._seed, self._ideal = noise, seed, ideal
        self._pressing, self._tips, self._clinging = pressing, tips, clinging
        shape = (2, noise.rows, noise.columns)
        rng = np.random.default_rng((seed, 0))
        self._gain = np.ones(shape) if ideal else 1.0 + noise.linearity * rng.standard_normal(shape)
        self._phase = rng.uniform(0.0, 2 * np.pi, shape)
        self._drift = 0.0 if ideal else noise.drift * np.sqrt(2.0)
        self._share = self._pattern()
        self._last: TactileReading | None = None

    def _pattern(self) -> Array:
        """Return the share (rows, columns) of the grip force on each cell."""
        z = (np.arange(self._noise.rows) + 0.5) * self._noise.spacing
        rows = np.exp(-(((z - HELD_DEPTH) / SPREAD) ** 2))
        columns = np.ones(self._noise.columns)
        share = np.outer(rows, columns)
        return share / share.sum()

    def reading(self, now: float) -> TactileReading:
        tick = int(np.floor(now * self._noise.rate + 1e-6))
        stamp = tick / self._noise.rate
        if self._last is not None and self._last.stamp == stamp:
            return self._last
        force = self._pressing() + np.array([self._clinging(), 0.0])
        cells = self._gain * self._share * force[:, None, None]
        tip = self._tips()
        if not self._ideal:
            rng = np.random.default_rng((self._seed, 1, tick))
            wander = self._drift * np.sin(2 * np.pi * stamp / DRIFT_PERIOD + self._phase)
            cells = cells + wander + self._noise.noise * rng.standard_normal(cells.shape)
            tip = tip + self._noise.tip_noise * rng.standard_normal(2)
        self._last = TactileReading(stamp, self.side, frozen(cells), frozen(tip))
        return self._last

    def forget(self) -> None:
        """Forget the last sample, because it belongs to another time after a world was restored."""
        self._last = None
