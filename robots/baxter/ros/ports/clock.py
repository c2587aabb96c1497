"""The cell's time over ROS: this machine's clock, or the topic /clock if the robot is simulated.

Stamps of other machines are not used. Messages are stamped by this clock on arrival.
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
"""Wall time after which the clock of a simulated robot that stands still counts as dead [s]."""
ROUNDING = 1e-6
WALL = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""The boot-time clock, because Linux's monotonic clock stops while the machine is suspended."""


class RosClock(Protocol):
    """The clock port (robots.ports.Clock)."""

    def now(self) -> float: ...

    def sleep_until(self, t: float) -> None: ...


class WallClock:
    """Seconds since its creation. It never runs backwards. Time in suspend counts, so that values from before it
    are old."""

    def __init__(self) -> None:
        self._start = time.clock_gettime(WALL)

    def now(self) -> float:
        return time.clock_gettime(WALL) - self._start

    def sleep_until(self, t: float) -> None:
        left = t - self.now()
        if left > 0.0:
            time.sleep(left)


class TopicClock:
    """The time of /clock. It may stand still and may run slower or faster than the wall clock."""

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
        """Wait up to `seconds` of wall time for a message. Returns whether any has arrived."""
        with self._told:
            return self._told.wait_for(lambda: self._heard, seconds)

    def now(self) -> float:
        return self._now

    def sleep_until(self, t: float) -> None:
        """Raises DriverError(HARDWARE_FAULT) if the clock stands still for SILENCE_S."""
        with self._told:
            while self._now < t - ROUNDING:
                before = self._now
                if not self._advances(before):
                    raise DriverError(
                        FailureKind.HARDWARE_FAULT,
                        f"the robot's clock stands still at {before:.2f} s",
                        "check whether the simulated robot is still running",
                    )

    def _advances(self, before: float) -> bool:
        return self._told.wait_for(lambda: self._now > before, SILENCE_S)


def cell_clock(node: Node) -> WallClock | TopicClock:
    """The clock that the parameter /use_sim_time selects."""
    return TopicClock(node) if node.parameter("/use_sim_time", False) else WallClock()
