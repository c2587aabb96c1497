"""The queue of commands that an operator or a script gives to a running cell.

The stop does not use this queue. It has its own port (foldcell.robots.ports.Stop).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Set
from dataclasses import dataclass
from threading import Condition

from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind

ANSWERS = frozenset({Event.APPROVE, Event.RETRY, Event.SKIP, Event.EDIT})
"""Commands that answer a question. When the next question is asked, earlier answers are dropped."""
OPERATOR_EVENTS = frozenset({Event.APPROVE, Event.RETRY, Event.SKIP, Event.PAUSE, Event.RESUME, Event.ABORT})
"""Commands of one word. EDIT needs a `PlanEdit` beside it."""
ABORTED = Failure(
    FailureKind.ABORTED, "the operator ended the run", "lay the garment out again and start a new run"
)


@dataclass(eq=False)
class QueuedCommand:
    """A command in the queue. taken: whether the executive has taken it. edit: of the command EDIT."""

    command: Event
    taken: bool = False
    edit: PlanEdit | None = None


class CommandQueue:
    """Commands in the order of their arrival. Any thread may put them; the executive's thread takes them."""

    def __init__(self, heard: Callable[[Event], None] = lambda command: None) -> None:
        """heard: called with each command, on the thread that puts it."""
        self._heard = heard
        self._queue: deque[QueuedCommand] = deque()
        self._lock = Condition()
        self._edit: PlanEdit | None = None
        self._deserted = False

    @property
    def deserted(self) -> bool:
        """Whether the operator has left. Then no further commands will come."""
        return self._deserted

    def put(self, command: Event, edit: PlanEdit | None = None) -> QueuedCommand:
        """Add a command. edit: for the command EDIT, and only for it. Raises ValueError for an event that is not
        an operator's command."""
        if command not in OPERATOR_EVENTS and (command is not Event.EDIT or edit is None):
            raise ValueError(f"'{command}' is no command; there are {', '.join(sorted(OPERATOR_EVENTS))}")
        with self._lock:
            queued = QueuedCommand(command, edit=edit)
            self._queue.append(queued)
            self._lock.notify_all()
        self._heard(command)
        return queued

    def close(self) -> None:
        """Put an ABORT, because the operator has left. Later questions stay unanswered."""
        self._deserted = True
        self.put(Event.ABORT)

    def take(self, wanted: Set[Event]) -> Event | None:
        """Take the first wanted command from the queue. Commands before it are outdated and dropped."""
        with self._lock:
            for i, queued in enumerate(self._queue):
                if queued.command in wanted:
                    for _ in range(i + 1):
                        self._queue.popleft()
                    queued.taken, self._edit = True, queued.edit
                    return queued.command
        return None

    def edit(self) -> str:
        """Return the edit of the command that was taken last (`PlanEdit.text`); empty if it was not EDIT."""
        return self._edit.text() if self._edit else ""

    def drop(self, void: Set[Event]) -> None:
        """Remove the waiting commands in `void`, because a command that was given before a question does not
        answer it."""
        with self._lock:
            self._queue = deque(queued for queued in self._queue if queued.command not in void)

    def wait(self, wanted: Set[Event], seconds: float) -> Event | None:
        """Like `take`, but wait up to `seconds` of wall time for a wanted command."""
        with self._lock:
            self._lock.wait_for(lambda: any(queued.command in wanted for queued in self._queue), seconds)
        return self.take(wanted)
