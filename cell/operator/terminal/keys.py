"""The operator at a terminal: typed letters become commands in the cell's queue.

The stop is not a typed command: it bypasses the queue (Ctrl-C, or the stop button).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Set
from contextlib import suppress
from threading import Lock, Thread
from typing import ClassVar, Protocol, TextIO
from weakref import WeakKeyDictionary

from foldcell.cell.record.words import COMMANDS
from foldcell.cell.states.commands import OPERATOR_EVENTS, CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import ConfigurationError

KEYS: Mapping[str, Event] = {
    "a": Event.APPROVE,
    "r": Event.RETRY,
    "s": Event.SKIP,
    "p": Event.PAUSE,
    "c": Event.RESUME,
    "q": Event.ABORT,
}
HELP = "  ".join(f"{key} {COMMANDS[event]}" for key, event in KEYS.items()) + "  Ctrl-C stop"


class Listener(Protocol):
    def take(self, line: str) -> None:
        """Handle a typed line, without spaces around it."""

    def left(self) -> None:
        """Called when the source has ended."""


class TypedLines:
    """Reads the lines typed into a source on a daemon thread and passes them to the present listener. There is one
    reader per source. When a new run begins, its operator becomes the listener in place of the operator of the
    previous run."""

    _of: ClassVar[WeakKeyDictionary[TextIO, TypedLines]] = WeakKeyDictionary()

    def __init__(self, source: TextIO) -> None:
        self._listener: Listener | None = None
        self._lock = Lock()
        self._ended = False
        self.thread = Thread(target=self._read, args=(source,), name="terminal-operator", daemon=True)

    @classmethod
    def of(cls, source: TextIO) -> TypedLines:
        return cls._of.setdefault(source, cls(source))

    def listen(self, listener: Listener) -> None:
        """Pass lines to `listener` from now on. If the source has ended, inform the listener immediately."""
        with self._lock:
            self._listener, begin, ended = listener, self.thread.ident is None, self._ended
        if begin:
            self.thread.start()
        elif ended:
            listener.left()

    def _read(self, source: TextIO) -> None:
        with suppress(OSError, ValueError):  # the source was closed
            for line in source:
                with self._lock:
                    listener = self._listener
                if listener is not None:
                    listener.take(line.strip())
        with self._lock:
            self._ended, listener = True, self._listener
        if listener is not None:
            listener.left()


class TerminalOperator:
    """Turns lines typed into `source` into commands, from `start` until another operator starts.

    If the source ends because the terminal was closed, nobody can answer any more. The command queue is then
    closed, unless commands can also come from elsewhere (`alone` is false).
    """

    def __init__(
        self,
        commands: CommandQueue,
        source: TextIO,
        answers: TextIO,
        alone: bool = True,
        may: Callable[[], Set[Event]] = lambda: OPERATOR_EVENTS,
    ) -> None:
        """answers: stream for answers to the operator; may: returns the commands that are possible now."""
        self._commands, self._alone, self._may = commands, alone, may
        self._hints = alone or source.isatty()  # beside a page, show the keys only if somebody can type here
        self._lines = TypedLines.of(source)
        self._answers = answers

    def start(self) -> None:
        if self._hints:
            self._say(f"keys (then Enter): {HELP}")
        self._lines.listen(self)

    def join(self, timeout: float | None = None) -> None:
        """Wait until the source has ended."""
        self._lines.thread.join(timeout)

    def left(self) -> None:
        if self._alone:
            self._commands.close()

    def take(self, line: str) -> None:
        word = line.lower()
        if not word:
            return
        event = KEYS.get(word) or next((e for e in KEYS.values() if word in (e.value, COMMANDS[e])), None)
        if event is None:
            self._say(f"'{word}' is no command; the commands are: {HELP}")
            return
        if event not in self._may():
            self._say(f"  {COMMANDS[event]}: this command is not possible now")
            return
        self._commands.put(event)
        self._say(f"  {COMMANDS[event]}: accepted")

    def _say(self, text: str) -> None:
        with suppress(OSError, ValueError):
            print(text, file=self._answers, flush=True)


def check_terminal(source: TextIO | None) -> None:
    """Check that somebody can answer. Raises ConfigurationError if there is no input, or if this process runs in
    the background of its terminal."""
    if source is None:
        raise ConfigurationError("nobody can answer: there is no terminal", "use the operator's page: supervise")
    with suppress(OSError, ValueError):
        if source.isatty() and not in_foreground(source):
            raise ConfigurationError(
                "nobody can answer: this process runs in the terminal's background",
                "start it in the foreground, or use the operator's page: supervise",
            )


def in_foreground(source: TextIO | None) -> bool:
    """Whether somebody can type into `source`: it is a terminal, and this process is in the terminal's foreground.
    Reading in the background would suspend the whole process, including motions and the operator's page."""
    try:
        return source is not None and source.isatty() and os.tcgetpgrp(source.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False
