"""Standard output and error that may go away: a pipe that nobody reads, a full disk, a stream that was closed.
What a command does, and its exit code, do not hang on who reads along.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import Any, TextIO, TypeVar, cast

__all__ = ["LastingStream", "lasting_streams"]


T = TypeVar("T")


class LastingStream:
    """A text stream that takes what it is given also when it can no longer be written. lost: why it cannot; an
    interruption while a reader was waited for counts, too: whoever ends the program would wait for him again."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost: OSError | KeyboardInterrupt | None = None

    def write(self, text: str) -> int:
        return self._last(lambda: self._stream.write(text), len(text))

    def flush(self) -> None:
        self._last(self._stream.flush, None)

    def _last(self, act: Callable[[], T], when_lost: T) -> T:
        if self.lost is None:
            try:
                return act()
            except OSError as e:
                self._lose(e)
            except KeyboardInterrupt as e:
                if not self._is_taken():
                    self._lose(e)
                raise
        return when_lost

    def _is_taken(self) -> bool:
        """Whether what is written would be taken at once."""
        try:
            return bool(select.select([], [self._stream.fileno()], [], 0.0)[1])
        except (OSError, ValueError):  # no file
            return True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self, error: OSError | KeyboardInterrupt) -> None:
        self.lost = error
        with suppress(OSError, ValueError):  # what is still buffered would be tried again as Python ends
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextmanager
def lasting_streams() -> Iterator[LastingStream]:
    """Within it sys.stdout, which is given, and sys.stderr last, and hold any letters: as escapes, where they have
    no code for them. Numbers 0 to 2 that are closed lead nowhere: a file that is opened later would get one of
    them, and what C libraries print with it, in a child too."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the lowest number that is free
    before = sys.stdout, sys.stderr
    kept = [LastingStream(stream or open(os.devnull, "w", encoding="utf-8")) for stream in before]  # noqa: SIM115
    for stream in before:
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    sys.stdout, sys.stderr = cast(TextIO, kept[0]), cast(TextIO, kept[1])
    try:
        yield kept[0]
    finally:
        for stream in kept:
            stream.flush()
        sys.stdout, sys.stderr = before
