"""Prompts to the operator during a calibration, and the answers that are allowed."""

from __future__ import annotations

from collections.abc import Callable, Set

from cell.states.transition_table import Event

__all__ = ["CalibrationPrompts"]


class CalibrationPrompts:
    """Asks the operator for help during a calibration. The latest request stays open until `ask(None)` withdraws
    it. say: shows a line to the operator."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._wanted: str | None = None

    def ask(self, what: str | None) -> None:
        """Ask the operator for something that the robot cannot do itself. None withdraws the request."""
        self._wanted = what
        if what is not None:
            self._say(f"{'':12}{what}, then approve (a, Enter)")

    def may(self) -> Set[Event]:
        """Return the commands allowed now. A calibration cannot be paused and has nothing to skip."""
        return {Event.ABORT} if self._wanted is None else {Event.ABORT, Event.APPROVE}
