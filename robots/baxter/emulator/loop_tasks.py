"""Tasks from other threads, executed on the loop's thread between two ticks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from threading import Lock
from typing import Any, TypeVar

SETTLE = 5
"""Number of ticks between a task and the resolution of its future. By then every topic shows the task's effect."""

T = TypeVar("T")


class LoopTasks:
    """A queue of tasks. `ask` may be called from any thread. All other methods belong to the loop's thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._asked: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._settling: deque[tuple[int, Future[Any], Callable[[], None]]] = deque()
        self._ticks = 0
        self._ended = False

    def ask(self, work: Callable[[], T]) -> Future[T]:
        """Queue a task. If the loop has ended, its future is cancelled immediately."""
        future: Future[T] = Future()
        with self._lock:
            if self._ended:
                future.cancel()
            else:
                self._asked.append((work, future))
        return future

    def run(self) -> bool:
        """Resolve the futures that are due, then run all queued tasks. Returns whether any task ran."""
        self._ticks += 1
        while self._settling and self._settling[0][0] <= self._ticks:
            self._settling.popleft()[2]()
        done = False
        for _ in range(len(self._asked)):
            work, future = self._asked.popleft()
            if future.set_running_or_notify_cancel():
                self._settling.append((self._ticks + SETTLE, future, _outcome(work, future)))
                done = True
        return done

    def end(self) -> None:
        """Resolve the futures of finished tasks and cancel the others."""
        with self._lock:
            self._ended = True
        while self._settling:
            self._settling.popleft()[2]()
        while self._asked:
            self._asked.popleft()[1].cancel()


def _outcome(work: Callable[[], T], future: Future[T]) -> Callable[[], None]:
    """Run the task. Returns a function that resolves its future."""
    try:
        result = work()
    except Exception as error:
        return lambda error=error: future.set_exception(error)  # type: ignore[misc]
    return lambda: future.set_result(result)
