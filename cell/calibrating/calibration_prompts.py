"""What the person at a cell is asked for during a calibration, and what can be answered."""

from __future__ import annotations

from collections.abc import Callable, Set

from cell.states.transition_table import Event

__all__ = ["CalibrationPrompts"]


class CalibrationPrompts:
    """say: shows a line. The newest question stands until it is not asked for any more."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._wanted: str | None = None

    def ask(self, what: str | None) -> None:
        """For something that the robot cannot do itself; None: it is not asked for any more."""
        self._wanted = what
        if what is not None:
            self._say(f"{'':12}{what}, then approve (a, Enter)")

    def may(self) -> Set[Event]:
        """What can be said at this moment: a calibration has no pause, and nothing to skip."""
        return {Event.ABORT} if self._wanted is None else {Event.ABORT, Event.APPROVE}
