"""The latest message of a topic, with its time of arrival."""

from __future__ import annotations

from collections.abc import Callable
from threading import Condition
from typing import Any, Generic, TypeVar

from foldcell.robots.ports import Clock
from foldcell.robots.ros.node import Node

SET_BACK_S = 1.0
"""A message that is older than the latest one by less than this was overtaken by it, or was repeated [s]. If it is
older by more, the sender's clock was set back."""

T = TypeVar("T")


class LatestMessage(Generic[T]):
    """Holds the latest valid message of a topic. read: (message, time of arrival [s]) -> value, or None for an
    invalid message, which is then ignored. then: called with each value, on the topic's thread. in_order: ignore
    messages that were sent before the latest one, by the stamps in their headers."""

    def __init__(
        self,
        node: Node,
        clock: Clock,
        topic: str,
        kind: Any,
        read: Callable[[Any, float], T | None],
        then: Callable[[T], None] = lambda value: None,
        in_order: bool = False,
    ) -> None:
        self.topic = topic
        self._clock, self._read, self._then = clock, read, then
        self._newest: T | None = None
        self._in_order, self._sent = in_order, 0.0
        self._arrived = Condition()
        node.subscribe(topic, kind, self._hear)

    @property
    def newest(self) -> T | None:
        """The latest value; None before the first valid message."""
        return self._newest

    def wait(self, seconds: float) -> bool:
        """Wait up to `seconds` of wall time for the first value. Returns whether a value has arrived."""
        with self._arrived:
            return self._arrived.wait_for(lambda: self._newest is not None, seconds)

    def _hear(self, message: Any) -> None:
        sent = message.header.stamp.to_sec() if self._in_order else 0.0
        value = self._read(message, self._clock.now())
        if value is None or (sent and 0.0 <= self._sent - sent < SET_BACK_S):
            return
        self._sent = sent
        with self._arrived:
            self._newest = value
            self._arrived.notify_all()
        self._then(value)
