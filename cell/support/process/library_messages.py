"""Suppress or capture messages that libraries print by themselves: OpenCV and its codecs, Rerun's log, warnings of
Python packages.

These messages are for programmers and not for the operator. The program states what went wrong in its own words.
"""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import RLock

QUIET: Mapping[str, str] = {"OPENCV_LOG_LEVEL": "SILENT", "RUST_LOG": "off"}
"""Environment variables that switch off the logs of OpenCV and Rerun. They are read when these libraries are
loaded."""


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Switch off the logs of OpenCV and Rerun and the warnings of Python packages within the context.

    If the user has set one of these variables or Python's option -W, the user's value is used.
    """
    added = {name: value for name, value in QUIET.items() if name not in os.environ}
    os.environ.update(added)
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:
                warnings.simplefilter("ignore")
            yield
    finally:
        for name in added:
            os.environ.pop(name, None)


_capturing = RLock()
# a process that is forked during a capture would have the captured file as its standard error
os.register_at_fork(
    before=_capturing.acquire, after_in_parent=_capturing.release, after_in_child=_capturing.release
)


@contextmanager
def captured_messages() -> Iterator[Callable[[], str]]:
    """Capture the output of C libraries to the standard error of the process. Yields a function that returns the
    captured text.

    The codecs of pictures (libjpeg, libpng) report a damaged picture only on standard error. The output of other
    threads to standard error is captured too, so one thread captures at a time and the others wait.
    """
    with _capturing:
        yield from _captured()


def _captured() -> Iterator[Callable[[], str]]:
    try:
        before = os.dup(2)
    except OSError:  # standard error is closed: there is nothing to capture
        yield lambda: ""
        return
    with tempfile.TemporaryFile() as file:

        def text() -> str:
            file.seek(0)
            return file.read().decode(errors="replace")

        os.dup2(file.fileno(), 2)
        try:
            yield text
        finally:
            os.dup2(before, 2)
            os.close(before)
