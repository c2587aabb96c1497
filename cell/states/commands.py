"""What an operator (or a script) says to a running cell: one queue, whoever speaks.

The stop does not come this way: it is out of band (robots.ports.Stop).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Set
from dataclasses import dataclass
from threading import Condition

from cell.states.transition_table import Event
from robots.errors import Failure, FailureKind

__all__ = ["ABORTED", "ANSWERS", "OPERATOR_EVENTS", "CommandQueue", "QueuedCommand"]

ANSWERS = frozenset({Event.APPROVE, Event.RETRY, Event.SKIP})
"""Commands that answer a question, and are void for the next one."""
OPERATOR_EVENTS = frozenset({Event.APPROVE, Event.RETRY, Event.SKIP, Event.PAUSE, Event.RESUME, Event.ABORT})
ABORTED = Failure(
    FailureKind.ABORTED, "the operator ended the run", "lay the garment out again and start a new run"
)


@dataclass(eq=False)
class QueuedCommand:
    """A command that was given. taken: whether the machine has acted on it."""

    command: Event
    taken: bool = False


class CommandQueue:
    """Commands in the order given. Any thread puts, the executive's takes."""

    def __init__(self, heard: Callable[[Event], None] = lambda command: None) -> None:
        """heard: is told of each command, on the thread of whoever gives it."""
        self._heard = heard
        self._queue: deque[QueuedCommand] = deque()
        self._lock = Condition()
        self.deserted = False
        """Nobody is left who could say anything."""

    def put(self, command: Event) -> QueuedCommand:
        """Raises ValueError for what is not an operator's to say."""
        if command not in OPERATOR_EVENTS:
            raise ValueError(f"'{command}' is no command; there are {', '.join(sorted(OPERATOR_EVENTS))}")
        with self._lock:
            said = QueuedCommand(command)
            self._queue.append(said)
            self._lock.notify_all()
        self._heard(command)
        return said

    def close(self) -> None:
        """Whoever spoke here has left: the run is told to end, and what is asked from now on stays unanswered."""
        self.deserted = True
        self.put(Event.ABORT)

    def take(self, wanted: Set[Event]) -> Event | None:
        """The first command in the queue that is wanted now; what came before it is out of date and dropped."""
        with self._lock:
            for i, said in enumerate(self._queue):
                if said.command in wanted:
                    for _ in range(i + 1):
                        self._queue.popleft()
                    said.taken = True
                    return said.command
        return None

    def drop(self, void: Set[Event]) -> None:
        """Forget these commands: what was said before a question was asked does not answer it."""
        with self._lock:
            self._queue = deque(said for said in self._queue if said.command not in void)

    def wait(self, wanted: Set[Event], seconds: float) -> Event | None:
        """As `take`, but give a person `seconds` of real time to say it."""
        with self._lock:
            self._lock.wait_for(lambda: any(said.command in wanted for said in self._queue), seconds)
        return self.take(wanted)
