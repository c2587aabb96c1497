"""What others ask to be done on the loop's thread, between two ticks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from threading import Lock
from typing import Any, TypeVar

__all__ = ["SETTLE", "LoopTasks"]

SETTLE = 5
"""Ticks between the work and its future: by then every topic tells of it."""

T = TypeVar("T")


class LoopTasks:
    """`ask` is callable from any thread, the rest belongs to the loop's."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._asked: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._settling: deque[tuple[int, Future[Any], Callable[[], None]]] = deque()
        self._ticks = 0
        self._ended = False

    def ask(self, work: Callable[[], T]) -> Future[T]:
        """Cancelled at once when the loop has ended."""
        future: Future[T] = Future()
        with self._lock:
            if self._ended:
                future.cancel()
            else:
                self._asked.append((work, future))
        return future

    def run(self) -> bool:
        """Settle what is due, then do all that was asked for; -> whether anything was done."""
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
        """What was done is told, what was not is cancelled."""
        with self._lock:
            self._ended = True
        while self._settling:
            self._settling.popleft()[2]()
        while self._asked:
            self._asked.popleft()[1].cancel()


def _outcome(work: Callable[[], T], future: Future[T]) -> Callable[[], None]:
    """Do the work; -> what tells its future of it."""
    try:
        result = work()
    except Exception as error:
        return lambda error=error: future.set_exception(error)  # type: ignore[misc]
    return lambda: future.set_result(result)
