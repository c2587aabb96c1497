"""The person at a real cell, who does what the robot cannot do and answers through the cell's command queue."""

from __future__ import annotations

from collections.abc import Callable

from foldcell.cell.states.commands import ABORTED, CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Attendant, BoardPlace, Clock, Stop

POLL_S = 0.1
LAY = "lay the garment flat on the table and step back"
BOARD = {
    BoardPlace.AWAY: "hold the calibration board: if a gripper has it, it opens after you approve",
    BoardPlace.SHOWN: "hold the calibration board in front of the camera, in a new pose",
    BoardPlace.LEFT_HAND: "put the calibration board between the left gripper's pads",
    BoardPlace.RIGHT_HAND: "put the calibration board between the right gripper's pads",
}


class PersonAttendant:
    """The attendant of a real cell: asks a person to act and waits until the person answers with APPROVE.

    ask: shows the request; called with None when the request no longer applies. lay: the request to lay the
    garment. hands: of a simulated cell, does what the person says was done. Raises DriverError: ABORTED if the
    operator ends the run or has left, STOPPED if the stop is triggered.
    """

    def __init__(
        self, commands: CommandQueue, stop: Stop, ask: Callable[[str | None], None], lay: str = LAY,
        hands: Attendant | None = None,
    ) -> None:  # fmt: skip
        self._commands, self._ask, self._lay, self._hands = commands, ask, lay, hands
        self.stop = stop
        """The stop that is polled during the wait for the person."""
        self.clock: Clock | None = None
        """Clock that is advanced during a wait; None: no clock is advanced. A scripted clock gives its commands as
        it advances."""

    def lay_garment(self) -> None:
        self.wait_for(self._lay)
        if self._hands is not None:
            self._hands.lay_garment()

    def bring_board(self, place: BoardPlace) -> None:
        self.wait_for(BOARD[place])

    def wait_for(self, what: str) -> None:
        """Ask the person for something, and wait until the person approves."""
        self._commands.drop({Event.APPROVE})  # an earlier approval is no answer to this request
        self._ask(what)
        try:
            while not self.stop.state().stopped:
                command = self._commands.wait({Event.APPROVE, Event.ABORT}, POLL_S)
                if command is Event.ABORT or (command is None and self._commands.deserted):
                    raise DriverError(FailureKind.ABORTED, ABORTED.what, ABORTED.hint)
                if command is not None:
                    return
                if self.clock is not None:
                    self.clock.sleep_until(self.clock.now() + POLL_S)
            raise DriverError(
                FailureKind.STOPPED, f"stopped while waiting for: {what}", "reset the stop, then start again"
            )
        finally:
            self._ask(None)
