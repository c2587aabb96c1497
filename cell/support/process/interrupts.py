"""Signals while a cell is open: they trigger the stop circuit, and the run then ends by its own rules."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from robots.ports import Ports

__all__ = ["Interrupts", "taking_signals"]


class Interrupts:
    """received: the signals that asked for an end, in order."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self._ports: Ports | None = None
        self._before: dict[int, Any] = {}

    @contextmanager
    def stop(self, ports: Ports, asked: bool) -> Iterator[None]:
        """From now on SIGINT and SIGTERM trigger the stop of `ports`, and what ends a run is not cut short by them
        either. A terminal that hangs up stops the cell too, unless somebody is asked there or elsewhere (`asked`),
        whose leaving ends the run. A program that was suspended stops a robot: who knows who has come near
        meanwhile. Off the main thread it does nothing."""
        self._ports = ports
        self._take(signal.SIGINT, self._heed)
        self._take(signal.SIGTERM, self._heed)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
            self._take(signal.SIGHUP, signal.SIG_IGN if asked else self._heed)
        if ports.driver != "sim":
            self._take(signal.SIGCONT, lambda *_: ports.stop.trigger("the program had been suspended"))
        try:
            yield
        finally:
            self._ports = None
            if signal.SIGCONT in self._before:
                signal.signal(signal.SIGCONT, self._before.pop(signal.SIGCONT))

    def _heed(self, number: int, _: Any) -> None:
        self.received.append(number)
        if self._ports is not None:
            self._ports.stop.trigger(signal.Signals(number).name)
            return
        with suppress(OSError, ValueError, RuntimeError):  # the terminal is gone, or in the middle of a line
            print("the run is being written to its end: a moment", file=sys.stderr, flush=True)

    def _take(self, number: int, handler: Any) -> None:
        with suppress(ValueError):
            self._before[number] = signal.signal(number, handler)

    def leave(self) -> None:
        """Signals do again what they did before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()


@contextmanager
def taking_signals() -> Iterator[Interrupts]:
    """Around all that has to be done once a cell is opened, to the last line of the journal and the report."""
    interrupts = Interrupts()
    try:
        yield interrupts
    finally:
        interrupts.leave()
