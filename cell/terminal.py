"""The operator at a terminal: letters typed become commands in the cell's one queue.

The stop is not among them: it is out of band (Ctrl-C, or the button).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from threading import Thread
from typing import TextIO

from cell.commands import CommandQueue
from cell.states import Event

__all__ = ["KEYS", "TerminalOperator", "in_foreground"]

KEYS: Mapping[str, Event] = {
    "a": Event.APPROVE,
    "r": Event.RETRY,
    "s": Event.SKIP,
    "p": Event.PAUSE,
    "c": Event.RESUME,
    "q": Event.ABORT,
}
HELP = "  ".join(f"{key} {event.value}" for key, event in KEYS.items()) + "  Ctrl-C stop"


class TerminalOperator:
    """Reads lines from `source` on a thread of its own, which never keeps the process alive.

    When the source ends (the terminal was closed) nobody is left to answer: the run is told to end, unless
    somebody sits elsewhere (`alone` is false).
    """

    def __init__(self, commands: CommandQueue, source: TextIO, answers: TextIO, alone: bool = True) -> None:
        self._commands, self._alone = commands, alone
        self._source = source
        self._answers = answers
        self._thread = Thread(target=self._read, name="terminal-operator", daemon=True)

    def start(self) -> None:
        self._say(f"keys (then Enter): {HELP}")
        self._thread.start()

    def join(self, timeout: float | None = None) -> None:
        """Wait until the source has ended."""
        self._thread.join(timeout)

    def _read(self) -> None:
        try:
            for line in self._source:
                self._take(line.strip().lower())
        except (OSError, ValueError):  # closed under our feet
            pass
        if self._alone:
            self._commands.put(Event.ABORT)

    def _take(self, word: str) -> None:
        if not word:
            return
        event = KEYS.get(word) or next((e for e in KEYS.values() if e.value == word), None)
        if event is None:
            self._say(f"'{word}' is no command; there are: {HELP}")
            return
        self._commands.put(event)
        self._say(f"  {event.value}: noted")

    def _say(self, text: str) -> None:
        with suppress(OSError, ValueError):
            print(text, file=self._answers, flush=True)


def in_foreground(source: TextIO | None) -> bool:
    """Whether somebody can type into `source`: a terminal whose foreground this process is. Reading it from the
    background would suspend the process, motions, page and all."""
    try:
        return source is not None and source.isatty() and os.tcgetpgrp(source.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False
