"""Let SIGTERM and SIGHUP end a command as Ctrl-C does: resources are closed and worker processes end."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer
from typing import Any

__all__ = ["BY_SIGNAL", "Terminated", "unwinding"]

BY_SIGNAL = 128
"""The exit code after a signal is this plus the signal's number: SIGHUP 129, SIGINT 130, SIGTERM 143."""
AGAIN_S = 0.02
"""Time after which a forgotten signal is sent again [s]."""


class Terminated(KeyboardInterrupt):
    """A termination signal arrived. Handlers of KeyboardInterrupt also catch it. number: the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def unwinding() -> Iterator[None]:
    """Within the context, the first SIGTERM or SIGHUP raises Terminated; a second one of the same kind kills the
    process.

    Python prints and forgets what a handler raises within a callback of its garbage collector or of a weak
    reference. Such a signal, also SIGINT, is sent again, AGAIN_S later.

    A signal that is ignored (nohup) stays ignored. While a cell is open, cell/support/process/interrupts.py
    handles these signals. Outside the main thread this function does nothing.
    """

    def end(number: int, _: Any) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise Terminated(number)

    def discarded(what: Any) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            report(what)
            return
        number = getattr(what.exc_value, "number", signal.SIGINT)
        if number in before:
            signal.signal(number, end)
        Timer(AGAIN_S, os.kill, (os.getpid(), number)).start()

    before: dict[int, Any] = {}
    report, sys.unraisablehook = sys.unraisablehook, discarded
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, end)
    except ValueError:  # not the main thread
        pass
    try:
        yield
    finally:
        sys.unraisablehook = report
        for replaced, handler in before.items():
            signal.signal(replaced, handler)
