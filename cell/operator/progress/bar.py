"""How far long work is: a bar on a terminal, plain lines now and then elsewhere."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from typing import TextIO

__all__ = ["ProgressBar"]

WIDTH = 24
EVERY_S = 15.0
"""Plain lines come no more often [s]."""
KNOWN = 3
"""From so many on, the time that they took says something about those to come."""


class ProgressBar:
    """Shows `done` of `total`, a remark and the time left. No stream, or one that is gone, never hinders."""

    def __init__(self, stream: TextIO | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream
        self._clock = clock
        self._terminal = stream is not None and stream.isatty()
        self._began = clock()
        self._told = self._began
        self._shown = False

    def update(self, done: int, total: int, remark: str = "") -> None:
        """So many of so many are done; total may change."""
        now = self._clock()
        text = f"{done}/{total}  {remark}{self._left(now, done, total)}"
        if self._terminal:
            full = min(WIDTH, WIDTH * done // max(total, 1))
            line = f"[{'#' * full}{'.' * (WIDTH - full)}] {text}"[: shutil.get_terminal_size().columns - 1]
            self._write(f"\r{line}\x1b[K")
            self._shown = True
        elif now - self._told >= EVERY_S:
            self._told = now
            self._write(text + "\n")

    def restart(self) -> None:
        """Other work begins: the time left counts from now."""
        self.clear()
        self._began = self._told = self._clock()

    def line(self, text: str) -> None:
        """A line that stays; the bar goes on below it."""
        self.clear()
        self._write(text + "\n")

    def clear(self) -> None:
        """Take the bar away."""
        if self._shown:
            self._write("\r\x1b[K")
            self._shown = False

    def _left(self, now: float, done: int, total: int) -> str:
        if done < KNOWN or done >= total:
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
