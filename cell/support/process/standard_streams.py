"""Let a command continue if standard output or error fails: a closed pipe, a full disk, a closed stream.

cell/commands/exit_codes.py decides how such a failure affects the exit code.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper, UnsupportedOperation
from typing import Any, TextIO, TypeVar, cast

T = TypeVar("T")


class LastingStream:
    """A text stream that still accepts text after it can no longer be written. The text is then discarded.

    lost: the reason why the stream can no longer be written; None while it works. A KeyboardInterrupt during a
    write that waits for the reader is also such a reason. Otherwise the program would wait for the same reader
    again when it ends.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.lost: OSError | KeyboardInterrupt | None = None

    def write(self, text: str) -> int:
        return self._try(lambda: self._stream.write(text), len(text))

    def flush(self) -> None:
        self._try(self._stream.flush, None)

    def _try(self, act: Callable[[], T], when_lost: T) -> T:
        if self.lost is None:
            try:
                return act()
            except OSError as e:
                self._lose(e)
            except KeyboardInterrupt as e:
                if not self._is_writable():
                    self._lose(e)
                raise
        return when_lost

    def _is_writable(self) -> bool:
        """Whether a write would not block."""
        try:
            return bool(select.select([], [self._stream.fileno()], [], 0.0)[1])
        except (OSError, ValueError):  # the stream is not a file
            return True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self, error: OSError | KeyboardInterrupt) -> None:
        self.lost = error
        with suppress(OSError, ValueError):  # otherwise Python writes the buffer again when it exits
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextmanager
def lasting_streams() -> Iterator[LastingStream]:
    """Replace sys.stdout and sys.stderr by lasting streams within the context. Yields the stream of standard
    output.

    Characters that the encoding lacks are written as escapes, and bytes that it lacks are read as escapes from
    standard input. If one of the file descriptors 0 to 2 is closed, it is opened on the null device. Otherwise a
    file that is opened later could get this number, and C libraries would write their output into that file, in
    child processes too.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # open takes the lowest free number
    before = sys.stdout, sys.stderr
    lasting = [LastingStream(stream or open(os.devnull, "w", encoding="utf-8")) for stream in before]  # noqa: SIM115
    for stream in (*before, sys.stdin):
        with suppress(UnsupportedOperation):  # standard input that was read already
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
    sys.stdout, sys.stderr = cast(TextIO, lasting[0]), cast(TextIO, lasting[1])
    try:
        yield lasting[0]
    finally:
        for stream in lasting:
            stream.flush()
        sys.stdout, sys.stderr = before
