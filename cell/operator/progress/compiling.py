"""Reports that code is being compiled: the first use after an installation waits for it without other output."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener

__all__ = ["compiling_told"]

PARTS = {
    "skills.cloth": "compiling the cloth simulation: once after an installation, about a minute",
    "skills.motion": "compiling the arms' kinematics: once after an installation, some seconds",
}
"""Message for each package and its subpackages. Code of other packages compiles in about a second."""


@contextmanager
def compiling_told(say: Callable[[str], None]) -> Iterator[None]:
    """Call `say` with a line when a package begins to compile; code from the compile cache gives no line."""
    with install_listener("numba:compile", _Listener(say)):
        yield


class _Listener(Listener):
    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._left = dict(PARTS)

    def on_start(self, event: Event) -> None:
        package = ".".join(event.data["dispatcher"].py_func.__module__.split(".")[:2])
        text = self._left.pop(package, None)
        if text is not None:
            self._say(text)

    def on_end(self, event: Event) -> None: ...
