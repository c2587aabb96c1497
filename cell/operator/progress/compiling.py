"""Reports that code is being compiled. Without these lines, the first use after an installation would wait for the
compiler in silence."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener

from foldcell.skills.compiled import WAITING

PARTS = {
    "foldcell.skills.cloth": "compiling the cloth simulation: once after an installation, about a minute",
    "foldcell.skills.motion": "compiling the arms' kinematics: once after an installation, some seconds",
}
"""Message for each package with its subpackages. Code of other packages compiles in about a second."""
WAITS = "waiting for the process that is "
"""Begin of the message if another process compiles the package, perhaps one that this run began."""
STILL_EVERY = 15.0
"""Time between two messages that compilation continues [s]."""


@contextmanager
def report_compilation(say: Callable[[str], None]) -> Iterator[None]:
    """Call `say` with a line when a package of PARTS begins to compile, or waits for another process that compiles
    it, and every STILL_EVERY s while this continues.

    Code that is loaded from the compile cache gives no line.
    """
    listener = _Listener(say)
    finished = threading.Event()
    ticker = threading.Thread(target=listener.report_until, args=(finished,), name="compiling", daemon=True)
    with install_listener("numba:compile", listener), install_listener(WAITING, listener):
        ticker.start()
        try:
            yield
        finally:
            finished.set()
            ticker.join()


class _Listener(Listener):
    """Listens to numba's compilations. They are nested, because the functions that a function calls are compiled
    within it. Only the outermost ones are timed."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._left = dict(PARTS)
        self._announced = False
        self._depth = 0
        self._began = 0.0
        self._spent = 0.0

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            self._began = time.monotonic()
        self._depth += 1
        waits = event.kind == WAITING
        module = event.data["module"] if waits else event.data["dispatcher"].py_func.__module__
        text = self._left.pop(".".join(module.split(".")[:3]), None)
        if text is not None:
            self._announced = True
            self._say(WAITS + text if waits else text)

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._spent += time.monotonic() - self._began

    def report_until(self, finished: threading.Event) -> None:
        """Report every STILL_EVERY s how long compilation has taken so far, if it still continues."""
        while not finished.wait(STILL_EVERY):
            if self._announced and self._depth:
                self._say(f"still compiling, {self._spent + time.monotonic() - self._began:.0f} s so far")
