"""The person at a real cell: asked for what the robot cannot do itself, and answers by the cell's one queue."""

from __future__ import annotations

from collections.abc import Callable

from cell.commands import CommandQueue
from cell.states import Event
from robots.ports import BoardPlace, Stop

__all__ = ["PersonAttendant"]

POLL_S = 0.1
BOARD = {
    BoardPlace.AWAY: "take the calibration board away",
    BoardPlace.SHOWN: "hold the calibration board before the camera, in another pose than before",
    BoardPlace.LEFT_HAND: "put the calibration board between the left gripper's pads",
    BoardPlace.RIGHT_HAND: "put the calibration board between the right gripper's pads",
}


class PersonAttendant:
    """ask: shows what is asked for, None when it is not any more. An answer is APPROVE; who stops or ends the run
    instead is not waited for any longer, and the runner meets that next."""

    def __init__(self, commands: CommandQueue, stop: Stop, ask: Callable[[str | None], None]) -> None:
        self._commands, self._stop, self._ask = commands, stop, ask

    def lay_garment(self) -> None:
        self._wait_for("lay the garment flat on the table and step back")

    def bring_board(self, place: BoardPlace) -> None:
        self._wait_for(BOARD[place])

    def _wait_for(self, what: str) -> None:
        self._commands.drop({Event.APPROVE})  # what was said before it was asked does not answer it
        self._ask(what)
        try:
            while not self._stop.state().stopped:
                said = self._commands.wait({Event.APPROVE, Event.ABORT}, POLL_S)
                if said is Event.ABORT:
                    self._commands.put(Event.ABORT)
                if said is not None:
                    return
        finally:
            self._ask(None)
