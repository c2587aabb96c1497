"""Handle signals. SIGTERM and SIGHUP end a command as Ctrl-C does: resources are closed and worker processes end.

While a cell is open, a signal triggers the stop circuit, and the run then ends as after any stop.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Timer
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foldcell.robots.ports import Ports

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

    A signal that is ignored (nohup) stays ignored. While a cell is open, `Interrupts`
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


class Interrupts:
    """Handles the signals of one run. received: the signals that requested an end of the run, in order of time.
    before: the handlers that were replaced."""

    def __init__(self) -> None:
        from multiprocessing import parent_process

        self.received: list[int] = []
        self._in_worker = parent_process() is not None
        self._ports: Ports | None = None
        self._simulated = False
        self.before: dict[int, Any] = {}

    @contextmanager
    def stop(self, ports: Ports, asked: bool) -> Iterator[None]:
        """Within the context, SIGINT and SIGTERM trigger the stop of `ports`. After it, until the end of
        `taking_signals`, the end of the run is written completely. Each signal is acknowledged by a message, and
        ends the waits of other threads for code that is being compiled. If the main thread of a simulated cell
        waits for such code, which may take minutes, the signal raises Terminated: the run then counts as
        interrupted.

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
            if signal.SIGCONT in self.before:
                signal.signal(signal.SIGCONT, self.before.pop(signal.SIGCONT))

    def _on_signal(self, number: int, _: Any) -> None:
        self.received.append(number)
        name = signal.Signals(number).name
        if self._ports is not None:
            self._ports.stop.trigger(name)
        if not self._in_worker:  # the parent of a worker process has said it
            says = f"{name}: the cell stops" if self._ports else "please wait: the end of the run is being written"
            with suppress(OSError, ValueError, RuntimeError):  # the terminal is closed, or a line is being printed
                print(says, file=sys.stderr, flush=True)
        compiled = sys.modules.get("foldcell.skills.compiled")  # without it, nothing is being compiled
        if compiled and compiled.abandon_compilation() and self._simulated:
            raise Terminated(number)

    def _install(self, number: int, handler: Any) -> None:
        with suppress(ValueError):
            self.before[number] = signal.signal(number, handler)


@contextmanager
def taking_signals() -> Iterator[Interrupts]:
    """Handle signals during a whole run. It begins when the cell is opened, and ends after the journal and the
    report."""
    interrupts = Interrupts()
    try:
        yield interrupts
    finally:
        for number, handler in interrupts.before.items():
            signal.signal(number, handler)
