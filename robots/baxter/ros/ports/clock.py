"""The cell's time over ROS: this machine's own, or that of the topic /clock where the robot is simulated.

Stamps of other machines are not trusted: what is heard is stamped by this clock when it arrives.
"""

from __future__ import annotations

import time
from threading import Condition
from typing import Any, Protocol

from robots.baxter.ros.messages import load_messages
from robots.baxter.ros.node import Node
from robots.baxter.ros.topics import CLOCK
from robots.errors import DriverError, FailureKind

__all__ = ["RosClock", "TopicClock", "WallClock", "cell_clock"]

SILENCE_S = 20.0
"""On the wall: a simulated robot's clock that stands still for so long has died."""
ROUNDING = 1e-6
WALL = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Linux's monotonic clock stands still while the machine is suspended."""


class RosClock(Protocol):
    """A port's clock (robots.ports.Clock)."""

    def now(self) -> float: ...

    def sleep_until(self, t: float) -> None: ...


class WallClock:
    """Seconds since it was made; never set back. The time in which the machine was suspended counts: what was
    known before it slept is old."""

    def __init__(self) -> None:
        self._start = time.clock_gettime(WALL)

    def now(self) -> float:
        return time.clock_gettime(WALL) - self._start

    def sleep_until(self, t: float) -> None:
        left = t - self.now()
        if left > 0.0:
            time.sleep(left)


class TopicClock:
    """What /clock says. It may stand still and it may go slower or faster than the wall's."""

    topic = CLOCK

    def __init__(self, node: Node) -> None:
        self._now, self._heard = 0.0, False
        self._told = Condition()
        node.subscribe(CLOCK, load_messages().clock, self._hear, queue=10)

    def _hear(self, message: Any) -> None:
        with self._told:
            self._now, self._heard = max(self._now, message.clock.to_sec()), True
            self._told.notify_all()

    def wait(self, seconds: float) -> bool:
        """Whether anything was heard within so long, on the wall."""
        with self._told:
            return self._told.wait_for(lambda: self._heard, seconds)

    def now(self) -> float:
        return self._now

    def sleep_until(self, t: float) -> None:
        """Raises DriverError(HARDWARE_FAULT) when the clock has died."""
        with self._told:
            while self._now < t - ROUNDING:
                before = self._now
                if not self._goes_on(before):
                    raise DriverError(
                        FailureKind.HARDWARE_FAULT,
                        f"the robot's clock stands still at {before:.2f} s",
                        "see whether the simulated robot is still running",
                    )

    def _goes_on(self, before: float) -> bool:
        return self._told.wait_for(lambda: self._now > before, SILENCE_S)


def cell_clock(node: Node) -> WallClock | TopicClock:
    """As the parameter /use_sim_time says."""
    return TopicClock(node) if node.parameter("/use_sim_time", False) else WallClock()
