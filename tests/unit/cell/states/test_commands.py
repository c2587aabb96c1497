"""The queue of an operator's commands tells of each command as it arrives."""

from __future__ import annotations

from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.transition_table import Event


def test_each_command_is_told_of_when_it_is_put() -> None:
    """Also the abort of an operator who has left. Commands that nobody takes are told of, too."""
    heard: list[Event] = []
    queue = CommandQueue(heard.append)
    queue.put(Event.PAUSE)
    queue.put(Event.RETRY)
    assert heard == [Event.PAUSE, Event.RETRY]
    queue.close()
    assert heard[-1] is Event.ABORT and queue.deserted
