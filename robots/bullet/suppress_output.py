"""Suppress the output of PyBullet's C code, which writes directly to the file descriptors.

The standard output of this program contains its results and must contain no other text.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["suppress_output"]


@contextmanager
def suppress_output() -> Iterator[None]:
    """Discard standard output and standard error inside the context. Python's buffers are flushed first."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    saved = [(fd, os.dup(fd)) for fd in (1, 2)]
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd, _ in saved:
            os.dup2(null, fd)
        yield
    finally:
        for fd, copy in saved:
            os.dup2(copy, fd)
            os.close(copy)
        os.close(null)
