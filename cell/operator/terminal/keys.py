"""The operator at a terminal: letters typed become commands in the cell's one queue.

The stop is not among them: it is out of band (Ctrl-C, or the button).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Set
from contextlib import suppress
from threading import Lock, Thread
from typing import ClassVar, TextIO
from weakref import WeakKeyDictionary

from cell.states.commands import OPERATOR_EVENTS, CommandQueue
from cell.states.transition_table import Event
from robots.errors import ConfigurationError

__all__ = ["KEYS", "TerminalOperator", "check_terminal", "in_foreground"]

KEYS: Mapping[str, Event] = {
    "a": Event.APPROVE,
    "r": Event.RETRY,
    "s": Event.SKIP,
    "p": Event.PAUSE,
    "c": Event.RESUME,
    "q": Event.ABORT,
}
HELP = "  ".join(f"{key} {event.value}" for key, event in KEYS.items()) + "  Ctrl-C stop"


class _Lines:
    """What is typed into a source, read on a thread of its own, which never keeps the process alive. It is given
    to whoever listens at that moment: the next run's operator follows the last one's."""

    _of: ClassVar[WeakKeyDictionary[TextIO, _Lines]] = WeakKeyDictionary()

    def __init__(self, source: TextIO) -> None:
        self._listener: TerminalOperator | None = None
        self._lock = Lock()
        self._ended = False
        self.thread = Thread(target=self._read, args=(source,), name="terminal-operator", daemon=True)

    @classmethod
    def of(cls, source: TextIO) -> _Lines:
        return cls._of.setdefault(source, cls(source))

    def tell(self, operator: TerminalOperator) -> None:
        """From now on; at once that it has ended, if it has."""
        with self._lock:
            self._listener, begin, ended = operator, self.thread.ident is None, self._ended
        if begin:
            self.thread.start()
        elif ended:
            operator.left()

    def _read(self, source: TextIO) -> None:
        with suppress(OSError, ValueError):  # closed under our feet
            for line in source:
                with self._lock:
                    listener = self._listener
                if listener is not None:
                    listener.take(line.strip().lower())
        with self._lock:
            self._ended, listener = True, self._listener
        if listener is not None:
            listener.left()


class TerminalOperator:
    """Takes the lines that are typed into `source` from when it starts until another one does.

    When the source ends (the terminal was closed) nobody is left to answer: the run is told to end, unless
    somebody sits elsewhere (`alone` is false).
    """

    def __init__(
        self,
        commands: CommandQueue,
        source: TextIO,
        answers: TextIO,
        alone: bool = True,
        may: Callable[[], Set[Event]] = lambda: OPERATOR_EVENTS,
    ) -> None:
        """may: what can be said at this moment."""
        self._commands, self._alone, self._may = commands, alone, may
        self._hints = alone or source.isatty()  # beside the page, to somebody who can type
        self._lines = _Lines.of(source)
        self._answers = answers

    def start(self) -> None:
        if self._hints:
            self._say(f"keys (then Enter): {HELP}")
        self._lines.tell(self)

    def join(self, timeout: float | None = None) -> None:
        """Wait until the source has ended."""
        self._lines.thread.join(timeout)

    def left(self) -> None:
        """The source has ended."""
        if self._alone:
            self._commands.close()

    def take(self, word: str) -> None:
        """A line that was typed."""
        if not word:
            return
        event = KEYS.get(word) or next((e for e in KEYS.values() if e.value == word), None)
        if event is None:
            self._say(f"'{word}' is no command; there are: {HELP}")
            return
        if event not in self._may():
            self._say(f"  {event.value}: that cannot be said now")
            return
        self._commands.put(event)
        self._say(f"  {event.value}: noted")

    def _say(self, text: str) -> None:
        with suppress(OSError, ValueError):
            print(text, file=self._answers, flush=True)


def check_terminal(source: TextIO | None) -> None:
    """Raises ConfigurationError where nobody could answer: no input, or a terminal in whose background this is."""
    if source is None:
        raise ConfigurationError("nobody can answer: there is no terminal", "use the operator's page: supervise")
    with suppress(OSError, ValueError):
        if source.isatty() and not in_foreground(source):
            raise ConfigurationError(
                "nobody can answer: this runs in the terminal's background",
                "start it in the foreground, or use the operator's page: supervise",
            )


def in_foreground(source: TextIO | None) -> bool:
    """Whether somebody can type into `source`: a terminal whose foreground this process is. Reading it from the
    background would suspend the process, motions, page and all."""
    try:
        return source is not None and source.isatty() and os.tcgetpgrp(source.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False
