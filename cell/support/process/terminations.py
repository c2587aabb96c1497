"""SIGTERM and SIGHUP end a command as Ctrl-C does: what is open is closed on the way out, workers end too."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["BY_SIGNAL", "Terminated", "unwinding"]

BY_SIGNAL = 128
"""And the signal's number is the exit code of what it ended: SIGHUP 129, SIGINT 130, SIGTERM 143."""


class Terminated(KeyboardInterrupt):
    """A termination signal came; whoever heeds Ctrl-C heeds it. number: the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def unwinding() -> Iterator[None]:
    """Within it these signals raise Terminated, the first of each kind; a second one kills. A signal that is
    ignored (nohup) stays so. While a cell is open they are its own (cell/support/process/interrupts.py). Off the
    main thread it does nothing."""

    def end(number: int, _: Any) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise Terminated(number)

    before: dict[int, Any] = {}
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, end)
    except ValueError:  # not the main thread
        pass
    try:
        yield
    finally:
        for taken, handler in before.items():
            signal.signal(taken, handler)
