"""Handle signals while a cell is open: a signal triggers the stop circuit, and the run then ends as after any
stop."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from robots.ports import Ports

__all__ = ["Interrupts", "taking_signals"]


class Interrupts:
    """Handles the signals of one run. received: the signals that requested an end of the run, in order of time."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self._ports: Ports | None = None
        self._before: dict[int, Any] = {}

    @contextmanager
    def stop(self, ports: Ports, asked: bool) -> Iterator[None]:
        """Within the context, SIGINT and SIGTERM trigger the stop of `ports`. After the context and before
        `leave`, a signal only prints a message, so that the end of the run is written completely.

        SIGHUP also triggers the stop, except in a run that asks an operator (`asked`). In such a run SIGHUP is
        ignored, and the closed terminal ends the run. With any driver except `sim`, SIGCONT triggers the stop,
        because someone may have come near while the program was suspended. Outside the main thread no signal is
        handled.
        """
        self._ports = ports
        self._install(signal.SIGINT, self._on_signal)
        self._install(signal.SIGTERM, self._on_signal)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup has made it ignored
            self._install(signal.SIGHUP, signal.SIG_IGN if asked else self._on_signal)
        if ports.driver != "sim":
            self._install(signal.SIGCONT, lambda *_: ports.stop.trigger("the program had been suspended"))
        try:
            yield
        finally:
            self._ports = None
            if signal.SIGCONT in self._before:
                signal.signal(signal.SIGCONT, self._before.pop(signal.SIGCONT))

    def _on_signal(self, number: int, _: Any) -> None:
        self.received.append(number)
        if self._ports is not None:
            self._ports.stop.trigger(signal.Signals(number).name)
            return
        with suppress(OSError, ValueError, RuntimeError):  # the terminal is closed, or a line is being printed
            print("please wait: the end of the run is being written", file=sys.stderr, flush=True)

    def _install(self, number: int, handler: Any) -> None:
        with suppress(ValueError):
            self._before[number] = signal.signal(number, handler)

    def leave(self) -> None:
        """Restore the previous signal handlers."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()


@contextmanager
def taking_signals() -> Iterator[Interrupts]:
    """Handle signals during a whole run. It begins when the cell is opened, and ends after the journal and the
    report."""
    interrupts = Interrupts()
    try:
        yield interrupts
    finally:
        interrupts.leave()
