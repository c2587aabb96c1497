"""A worker thread behind a bounded queue: who offers never waits, what does not fit is counted."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Pump"]

T = TypeVar("T")


class Pump(Generic[T]):
    """Takes items on any thread, works them off in order on its own.

    limit: the sum of the costs that may wait (items or bytes, as the caller counts). An item marked
    essential is taken even when the queue is full: those are few and small, and without them (state
    changes, the scene's fixed parts) the rest cannot be read. What `work` raises goes to `on_error`.
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
        self.done = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def offer(self, item: T, cost: float = 1.0, essential: bool = False) -> bool:
        """Queue an item; False when it was dropped. Never blocks."""
        with self._changed:
            if self._closing or (self._cost + cost > self._limit and not essential):
                self.dropped += 1
                return False
            self._waiting.append((item, cost))
            self._cost += cost
            self._changed.notify()
        return True

    def close(self, timeout: float) -> bool:
        """Work off what waits, for `timeout` seconds at most; False when something was left (and counted)."""
        deadline = time.monotonic() + timeout
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if not self._thread.is_alive():
            return True
        with self._changed:  # a daemon thread: it cannot hold up the end of the process
            self.dropped += len(self._waiting)
            self._waiting.clear()
        return False

    def _run(self) -> None:
        self._guard(self._start)
        while True:
            with self._changed:
                while not self._waiting and not self._closing:
                    self._changed.wait()
                if not self._waiting:
                    break
                item, cost = self._waiting.popleft()
            self._guard(self._work, item)
            with self._changed:
                self._cost -= cost
                self.done += 1
        self._guard(self._finish)

    def _guard(self, function: Callable | None, *arguments: T) -> None:
        """A worker that dies would lose all that follows: errors are told, and the work goes on."""
        if function is None:
            return
        try:
            function(*arguments)
        except Exception as error:
            self._on_error(error)
