"""Standard output and error that may go away: a pipe that nobody reads, a full disk, a stream that was closed.
What a command does, and its exit code, do not hang on who reads along.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

__all__ = ["LastingStream", "lasting_streams"]


class LastingStream:
    """A text stream that takes what it is given also when it can no longer be written. lost: why it cannot."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost: OSError | None = None

    def write(self, text: str) -> int:
        if self.lost is None:
            try:
                return self._stream.write(text)
            except OSError as e:
                self._lose(e)
        return len(text)

    def flush(self) -> None:
        if self.lost is None:
            try:
                self._stream.flush()
            except OSError as e:
                self._lose(e)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self, error: OSError) -> None:
        self.lost = error
        with suppress(OSError, ValueError):  # what is still buffered would be tried again as Python ends
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextmanager
def lasting_streams() -> Iterator[LastingStream]:
    """Within it sys.stdout, which is given, and sys.stderr last. Numbers 0 to 2 that are closed lead nowhere: a
    file that is opened later would get one of them, and what C libraries print with it, in a child too."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the lowest number that is free
    before = sys.stdout, sys.stderr
    kept = [LastingStream(stream or open(os.devnull, "w", encoding="utf-8")) for stream in before]  # noqa: SIM115
    sys.stdout, sys.stderr = cast(TextIO, kept[0]), cast(TextIO, kept[1])
    try:
        yield kept[0]
    finally:
        for stream in kept:
            stream.flush()
        sys.stdout, sys.stderr = before
