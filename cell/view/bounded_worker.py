"""A worker thread with a bounded queue: callers never wait, and items that do not fit are dropped and counted."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

EVERY_S = 0.05
"""Time after which the thread looks for new items [s]. A run offers several hundred items a second. If each item
woke the thread, the two threads would take the interpreter from each other all the time."""


class BoundedWorker(Generic[T]):
    """Accepts items on any thread and processes them in order on a separate thread.

    limit: largest sum of the costs of waiting items. The caller chooses the unit of cost: items or bytes. An
    essential item is accepted even if the queue is full. Essential items (state changes, the scene's fixed parts)
    are few and small, and other items cannot be shown without them. `on_error` receives the exceptions of `work`.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[T], None],
        on_error: Callable[[BaseException], None],
        limit: float,
        start: Callable[[], None] | None = None,
        finish: Callable[[], None] | None = None,
    ) -> None:
        self._work, self._on_error, self._limit = work, on_error, limit
        self._start, self._finish = start, finish
        self._waiting: deque[tuple[T, float]] = deque()
        self._cost = 0.0
        self._closing = False
        self._changed = threading.Condition()
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def offer(self, item: T, cost: float = 1.0, essential: bool = False) -> bool:
        """Queue an item. Returns False if it was dropped. Never blocks."""
        with self._changed:
            if self._closing or (self._cost + cost > self._limit and not essential):
                self.dropped += 1
                return False
            self._waiting.append((item, cost))
            self._cost += cost
        return True

    def close(self, timeout: float) -> bool:
        """Process the waiting items for at most `timeout` seconds, then drop the rest. Returns False if the time
        was too short."""
        deadline = time.monotonic() + timeout
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if not self._thread.is_alive():
            return True
        with self._changed:  # the thread is a daemon: it does not block the end of the process
            self.dropped += len(self._waiting)
            self._waiting.clear()
        return False

    def _run(self) -> None:
        self._guard(self._start)
        while True:
            with self._changed:
                while not self._waiting and not self._closing:
                    self._changed.wait(EVERY_S)
                if not self._waiting:
                    break
                item, cost = self._waiting.popleft()
            self._guard(self._work, item)
            with self._changed:
                self._cost -= cost
        self._guard(self._finish)

    def _guard(self, function: Callable | None, *arguments: T) -> None:
        """Call `function` and report its exception, which must not end the thread."""
        if function is None:
            return
        try:
            function(*arguments)
        except Exception as error:
            self._on_error(error)
