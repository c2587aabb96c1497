"""Handle signals while a cell is open: a signal triggers the stop circuit, and the run then ends as after any
stop."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from typing import Any

from foldcell.cell.support.process.terminations import Terminated
from foldcell.robots.ports import Ports

__all__ = ["Interrupts", "taking_signals"]


class Interrupts:
    """Handles the signals of one run. received: the signals that requested an end of the run, in order of time."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self._ports: Ports | None = None
        self._simulated = False
        self._before: dict[int, Any] = {}

    @contextmanager
    def stop(self, ports: Ports, asked: bool) -> Iterator[None]:
        """Within the context, SIGINT and SIGTERM trigger the stop of `ports`. After the context and before
        `leave`, the end of the run is written completely. Each signal is acknowledged by a message, and ends the
        waits of other threads for code that is being compiled. If the main thread of a simulated cell waits for
        such code, which may take minutes, the signal raises Terminated: the run then counts as interrupted.

        SIGHUP also triggers the stop, except in a run that asks an operator (`asked`). In such a run SIGHUP is
        ignored, and the closed terminal ends the run. With any driver except `sim`, SIGCONT triggers the stop,
        because someone may have come near while the program was suspended. Outside the main thread no signal is
        handled.
        """
        self._ports, self._simulated = ports, ports.simulated
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
        name = signal.Signals(number).name
        if self._ports is not None:
            self._ports.stop.trigger(name)
        if parent_process() is None:  # the parent of a worker process has said it
            says = f"{name}: the cell stops" if self._ports else "please wait: the end of the run is being written"
            with suppress(OSError, ValueError, RuntimeError):  # the terminal is closed, or a line is being printed
                print(says, file=sys.stderr, flush=True)
        compiled = sys.modules.get("foldcell.skills.compiled")  # without it, nothing is being compiled
        if compiled and compiled.abandon_compilation() and self._simulated:
            raise Terminated(number)

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
