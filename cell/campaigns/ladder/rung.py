"""What a step of the ladder works with, and the recording of the arms during it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from foldcell.cell.hardware.contract.rig import Rig
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.ports import Array, Ports

EVERY_S = 0.02
"""Period of the recording [s]."""


@dataclass(frozen=True, eq=False)
class Curve:
    """The arms during a step. t: (n,) cell time [s]; q: (n, joints) [rad]."""

    t: Array
    q: Array


@dataclass(eq=False)
class Recording:
    """Records the joint states after each sleep on the clock of its ports."""

    _t: list[float] = field(default_factory=list)
    _q: list[Array] = field(default_factory=list)

    def between(self, ports: Ports) -> Ports:
        def sleep_until(t: float) -> None:
            ports.clock.sleep_until(t)
            state = ports.arms.state()
            if np.isfinite(state.q).all() and (not self._t or state.stamp >= self._t[-1] + EVERY_S):
                self._t.append(state.stamp)
                self._q.append(state.q)

        return replace(ports, clock=forwarding(ports.clock, sleep_until=sleep_until))

    def take(self) -> Curve | None:
        """Return the curve since the last call, None without two joint states."""
        t, q, self._t, self._q = self._t, self._q, [], []
        return Curve(np.array(t), np.array(q)) if len(t) > 1 else None


@dataclass(frozen=True, eq=False)
class Rung:
    """The open cell of a step. rig: its ports as the clauses of a driver use them. cell: the same as a run uses
    them. tell: shows a line to the person at a robot; nobody is there in a simulated cell."""

    rig: Rig
    cell: Workcell
    tell: Callable[[str], None]
