"""Show the progress of long work: a bar on a terminal, plain lines at intervals on any other stream."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from typing import TextIO

WIDTH = 24
EVERY_S = 15.0
"""Shortest time between two plain lines [s]."""
MIN_DONE = 3
"""The time left is estimated only if at least this number of items is done."""


class ProgressBar:
    """Shows `done` of `total`, a remark and the time left. Never raises if the stream is missing or closed."""

    def __init__(self, stream: TextIO | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream
        self._clock = clock
        self._terminal = stream is not None and stream.isatty()
        self._began = clock()
        self._last_line = self._began
        self._shown = False

    def update(self, done: int, total: int, remark: str = "") -> None:
        """Show that `done` of `total` items are done; `total` may change."""
        now = self._clock()
        text = f"{done}/{total}  {remark}{self._left(now, done, total)}"
        if self._terminal:
            full = min(WIDTH, WIDTH * done // max(total, 1))
            line = f"[{'#' * full}{'.' * (WIDTH - full)}] {text}"[: shutil.get_terminal_size().columns - 1]
            self._write(f"\r{line}\x1b[K")
            self._shown = True
        elif now - self._last_line >= EVERY_S:
            self._last_line = now
            self._write(text + "\n")

    def restart(self) -> None:
        """Begin a new task: the time left is estimated from now on."""
        self.clear()
        self._began = self._last_line = self._clock()

    def line(self, text: str) -> None:
        """Write a line that stays; the bar continues below it."""
        self.clear()
        self._write(text + "\n")

    def clear(self) -> None:
        """Remove the bar."""
        if self._shown:
            self._write("\r\x1b[K")
            self._shown = False

    def _left(self, now: float, done: int, total: int) -> str:
        if done < MIN_DONE or done >= total:
            return ""
        seconds = round((now - self._began) / done * (total - done))
        minutes = f"{seconds // 60} min " if seconds >= 60 else ""
        return f"  {minutes}{seconds % 60} s left"

    def _write(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):  # a closed pipe or stream
            self._stream = None
