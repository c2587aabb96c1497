"""Topics without a network, with a clock that a test sets."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any


class Wire:
    """A node whose topics are function calls, and its clock. Only the newest command is queued, as with rospy's
    queue of one. time [s]."""

    def __init__(self) -> None:
        self.told: deque[Any] = deque(maxlen=1)
        self.count = 0
        self.heard: Callable[[Any], None] = lambda message: None
        self.time = 0.0

    def publisher(self, topic: str, kind: Any, latch: bool = False) -> Wire:
        return self

    def subscribe(self, topic: str, kind: Any, heard: Callable[[Any], None], queue: int = 1) -> None:
        self.heard = heard

    def publish(self, message: Any) -> None:
        self.told.append(message)
        self.count += 1

    def now(self) -> float:
        return self.time

    def sleep_until(self, t: float) -> None:
        raise AssertionError("what hangs on this wire waits for nobody")
