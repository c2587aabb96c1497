"""The network between the emulated robot and the programs: messages on their way."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Callable
from copy import copy
from threading import Lock
from typing import Any

from foldcell.robots.ros.driver import Network

ROUNDING = 1e-6


class Line:
    """One direction of the network, by the emulator's time. `send` may be called from any thread; `deliver`
    belongs to the loop's thread. Without a disturbance the next `deliver` delivers each message, in
    the order of sending."""

    def __init__(self, network: Network) -> None:
        self._network, self._random, self._lock = network, random.Random(0), Lock()
        self._on_the_way: list[tuple[float, int, Callable[[float], None]]] = []
        self._sent = 0
        self._latest: dict[str, float] = {}
        """Arrival of the latest message of each topic [s]."""

    def __len__(self) -> int:
        return len(self._on_the_way)

    def send(self, topic: str, now: float, arrive: Callable[[float], None], latched: bool = False) -> None:
        """Send a message at time `now` [s]. `arrive` is called with its time of arrival. latched: the message is
        not lost, because ROS sends it again with each connection."""
        network = self._network
        with self._lock:
            if not latched and self._random.random() < network.loss:
                return
            due = now + max(0.0, network.delay + network.jitter * self._random.uniform(-1.0, 1.0))
            if not network.reordering:
                due = self._latest[topic] = max(due, self._latest.get(topic, -math.inf))
            self._sent += 1
            heapq.heappush(self._on_the_way, (due, self._sent, arrive))

    def deliver(self, now: float) -> None:
        """Deliver the messages that have arrived until `now`."""
        arrived = []
        with self._lock:
            while self._on_the_way and self._on_the_way[0][0] <= now + ROUNDING:
                arrived.append(heapq.heappop(self._on_the_way))
        for due, _, arrive in arrived:
            arrive(due)


def by_robots_clock(message: Any, ahead: float) -> Any:
    """Return the message with the stamp of a robot whose clock is `ahead` of the cell's [s]."""
    if not ahead:
        return message
    moved = copy(message)
    if hasattr(moved, "header"):
        moved.header = copy(moved.header)  # images share theirs
        moved.header.stamp = _ahead(moved.header.stamp, ahead)
    elif hasattr(moved, "timestamp"):
        moved.timestamp = _ahead(moved.timestamp, ahead)
    return moved


def _ahead(stamp: Any, seconds: float) -> Any:
    return type(stamp).from_sec(max(0.0, stamp.to_sec() + seconds))
