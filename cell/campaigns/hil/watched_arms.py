"""Arms that count the set-points which are sent after a stop."""

from __future__ import annotations

from robots.ports import Arms, Array, JointSetpoint, JointState, Stop

__all__ = ["WatchedArms"]


class WatchedArms:
    """Wraps a cell's arms. A stop counts from the first `note` that finds it, also if the stop circuit
    closes again by itself."""

    def __init__(self, arms: Arms, stop: Stop) -> None:
        self._arms, self._stop = arms, stop
        self.command_timeout = arms.command_timeout
        self.stopped = False
        self.sent_after_stop = 0

    def note(self) -> None:
        """Read the stop circuit."""
        self.stopped = self.stopped or self._stop.state().stopped

    def state(self) -> JointState:
        return self._arms.state()

    def enable(self) -> None:
        self._arms.enable()

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        """Send one set-point. It counts even if the driver refuses it."""
        self.note()
        self.sent_after_stop += self.stopped
        return self._arms.command(q, qd)
