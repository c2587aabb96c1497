"""The person at a real cell: asked for what the robot cannot do itself, and answers by the cell's one queue."""

from __future__ import annotations

from collections.abc import Callable

from cell.states.commands import ABORTED, CommandQueue
from cell.states.transition_table import Event
from robots.errors import DriverError, FailureKind
from robots.ports import BoardPlace, Clock, Stop

__all__ = ["PersonAttendant"]

POLL_S = 0.1
BOARD = {
    BoardPlace.AWAY: "take hold of the calibration board: a hand that has it lets go when you have approved",
    BoardPlace.SHOWN: "hold the calibration board before the camera, in another pose than before",
    BoardPlace.LEFT_HAND: "put the calibration board between the left gripper's pads",
    BoardPlace.RIGHT_HAND: "put the calibration board between the right gripper's pads",
}


class PersonAttendant:
    """ask: shows what is asked for, None when it is not any more. The answer is APPROVE. Who ends the run, stops
    the cell or has left instead has not done it: DriverError, ABORTED or STOPPED."""

    def __init__(self, commands: CommandQueue, stop: Stop, ask: Callable[[str | None], None]) -> None:
        self._commands, self._stop, self._ask = commands, stop, ask
        self.clock: Clock | None = None
        """What a script is carried out on the way of, while somebody is waited for."""

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
                if said is Event.ABORT or (said is None and self._commands.deserted):
                    raise DriverError(FailureKind.ABORTED, ABORTED.what, ABORTED.hint)
                if said is not None:
                    return
                if self.clock is not None:
                    self.clock.sleep_until(self.clock.now() + POLL_S)
            raise DriverError(
                FailureKind.STOPPED, f"stopped before it was done: {what}", "reset the stop, then start again"
            )
        finally:
            self._ask(None)
