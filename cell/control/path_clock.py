"""The clock that moves a motion along its checked path, and the control that pauses and resumes it on the path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.states.commands import CommandQueue
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory, Array
from foldcell.skills.motion.timing.timing import STOP_TIME, ClockWarp, warp_clock

BEHIND_S, AHEAD_S = 0.2, 1.0
"""Arms that get no set-points come to rest on this part of the path, before and after the last set-point [s]. They
go on until the command timeout, and then brake."""


@dataclass(eq=False)
class PathControl:
    """Control of a motion along its path: the source of commands, and the limits of stopping and starting.

    commands: source of PAUSE, RESUME and ABORT; None: the motion cannot be paused. stop, go: joint limits while
    the clock slows down and speeds up. tell: shows a line to the operator. note: writes the events "paused" and
    "resumed" to the journal, while the arms rest. waited_s: cell time spent at rest in the pauses of all motions.
    stop_s: time in which the clock slows to a stop, unless `stop` demands more [s].
    """

    commands: CommandQueue | None
    stop: JointLimits
    go: JointLimits
    tell: Callable[[str], None] = lambda _: None
    note: Callable[[str, Mapping[str, float]], None] = lambda name, values: None
    waited_s: float = 0.0
    stop_s: float = STOP_TIME


class PathClock:
    """The motion's own clock. It can run, slow to a stop, rest and start again. The motion never leaves its path,
    because only this clock changes."""

    def __init__(self, trajectory: ArmTrajectory, control: PathControl) -> None:
        self._trajectory, self._control = trajectory, control
        self._base, self._ticks = 0.0, 0
        """The clock's time when its speed last changed [s], and the number of ticks since then. Counting ticks
        avoids a sum of rounding errors."""
        self._warp: ClockWarp | None = None
        self._goal = 1.0

    @property
    def t(self) -> float:
        """The motion's own time [s]."""
        if self._warp is None:
            return self._base + self._ticks * TICK_S * self._goal
        return float(self._warp.at(self._ticks * TICK_S)[0])

    @property
    def resting(self) -> bool:
        return self._goal == 0.0 and self._warp is None

    @property
    def arrived(self) -> bool:
        return self._goal == 1.0 and self.t >= self._trajectory.duration

    def setpoint(self) -> tuple[Array, Array]:
        """Return q, qd (joints,) at the clock's present time [rad], [rad/s]."""
        q, qd = self._trajectory.at(self.t)
        return q, qd * self._rate()[0]

    def advance(self) -> None:
        """Advance the clock by one tick."""
        self._ticks += 1
        if self._warp is not None and self._ticks * TICK_S >= self._warp.duration - 1e-9:
            beyond = self._ticks * TICK_S - self._warp.duration
            self._base, self._ticks = self.t + beyond * self._goal, 0
            self._warp = None

    def stop(self) -> None:
        self._change(0.0, self._control.stop, self._control.stop_s)

    def rest(self) -> None:
        """Rest at the present time, without slowing down first, because the arms rest already."""
        self._base, self._ticks, self._warp, self._goal = self.t, 0, None, 0.0

    def go(self) -> None:
        self._change(1.0, self._control.go, STOP_TIME)

    def rejoin(self, q: Array) -> Array:
        """Continue from where the arms have come to rest after a tick that came too late: at the path's point
        nearest to q (joints,), which may lie behind or ahead of the last set-point. Returns this point (joints,)
        [rad].

        A running clock speeds up from rest, as after a pause. A clock that was slowing down rests there.
        """
        runs, self._base, self._ticks, self._warp = self._goal == 1.0, self._nearest(q), 0, None
        self.rest()
        if runs:
            self.go()
        return self._trajectory.at(self.t)[0]

    def _nearest(self, q: Array) -> float:
        """Return the time of the path's point nearest to q (joints,), near the clock's present time [s]."""

        def distance(t: float) -> float:
            return float(np.square(self._trajectory.at(t)[0] - q).sum())

        first, last = max(0.0, self.t - BEHIND_S), min(self._trajectory.duration, self.t + AHEAD_S)
        times = np.linspace(first, max(first, last), round((BEHIND_S + AHEAD_S) / TICK_S) + 1)
        t = float(times[np.argmin([distance(x) for x in times])])
        near = minimize_scalar(
            distance, bounds=(t - TICK_S, t + TICK_S), method="bounded", options={"xatol": 1e-9}
        )
        return float(np.clip(near.x, first, last))

    def _rate(self) -> tuple[float, float]:
        if self._warp is None:
            return self._goal, 0.0
        _, rate, slope = self._warp.at(self._ticks * TICK_S)
        return float(rate), float(slope)

    def _change(self, goal: float, limits: JointLimits, seconds: float) -> None:
        change = ClockWarp(self.t, seconds, goal, *self._rate())
        self._warp, self._goal, self._ticks = warp_clock(self._trajectory, change, limits), goal, 0
