"""Keeping PyBullet's C printing off the terminal: it writes to the file descriptors, past Python.

A result that is printed as the last line of standard output must not have somebody else's words before it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["suppress_output"]


@contextmanager
def suppress_output() -> Iterator[None]:
    """Standard output and error go nowhere meanwhile. What Python has buffered is written out before."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    kept = [(fd, os.dup(fd)) for fd in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd, _ in kept:
            os.dup2(nowhere, fd)
        yield
    finally:
        for fd, copy in kept:
            os.dup2(copy, fd)
            os.close(copy)
        os.close(nowhere)
