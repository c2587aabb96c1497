"""The cell's time over ROS: this machine's clock, or the topic /clock if the robot is simulated.

Stamps of other machines are not used. Each message gets a stamp of this clock when it arrives.
"""

from __future__ import annotations

import time
from threading import Condition
from typing import Any

from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.topics import CLOCK
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ros.node import Node

SILENCE_S = 20.0
"""If the clock of a simulated robot does not advance for this wall time, it counts as dead [s]."""
ROUNDING = 1e-6
WALL = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""The boot-time clock. It is used because Linux's monotonic clock stops while the machine is suspended."""


class WallClock:
    """Seconds since the creation of this clock. It never runs backwards. It also counts while the machine is
    suspended, so that values from before the suspension are old."""

    def __init__(self) -> None:
        self._start = time.clock_gettime(WALL)

    def now(self) -> float:
        return time.clock_gettime(WALL) - self._start

    def sleep_until(self, t: float) -> None:
        left = t - self.now()
        if left > 0.0:
            time.sleep(left)


class TopicClock:
    """The time of /clock. It may stop, and it may run slower or faster than the wall clock."""

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
        """Wait up to `seconds` of wall time for the first message. Returns whether a message has arrived."""
        with self._told:
            return self._told.wait_for(lambda: self._heard, seconds)

    def now(self) -> float:
        return self._now

    def sleep_until(self, t: float) -> None:
        """Wait until time t. Raises DriverError(HARDWARE_FAULT) if the clock does not advance for SILENCE_S."""
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
    """Return the clock that the parameter /use_sim_time selects."""
    return TopicClock(node) if node.parameter("/use_sim_time", False) else WallClock()
