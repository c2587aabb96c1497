"""The one loop that sends set-points, 100 of them a second, for folds and calibrations alike.

It runs a motion (motion.py): it sends a set-point, waits for the tick, judges what was read since, and asks for
the next set-point. The stop, the state's age, altered set-points, straying arms, pause and abort are judged here
for every motion. What a motion is about (arrival, touch, force, slip) it judges itself. docs/safety.md states
the order.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import TypeVar

from cell.control.checks import ExecutionLimits, followed, fresh_state, start_mismatch, stopped
from cell.control.last_command import LastCommand
from cell.control.motion import Feedback, Motion, SetPoint
from cell.control.path_clock import PathControl
from cell.control.pausing import Interruptions
from cell.control.ticks import Ticks
from robots.errors import FailureKind
from robots.ports import JointState, Ports
from skills.vocabulary import Outcome

__all__ = ["ControlLoop"]

V = TypeVar("V")


@dataclass(frozen=True, eq=False)
class ControlLoop:
    """sent: remembers the last set-point from one motion to the next."""

    ports: Ports
    limits: ExecutionLimits
    last_command: LastCommand

    def run(
        self,
        begin: Callable[[JointState], Motion[V]],
        control: PathControl | None = None,
        standing: bool = False,
    ) -> Outcome[V]:
        """Run the motion that `begin` makes of the arms' state, to its end.

        control: lets the operator hold the motion up. standing: the motion goes nowhere. Arms of which nothing
        recent is known at its start are then told nothing: where they last were may be far from where they are,
        and a driver that hears nothing for its command timeout holds them. Failures: the motion's own; STOPPED,
        STALE_STATE, START_MISMATCH, LIMIT_EXCEEDED (an altered set-point), TRACKING_ERROR, ABORTED. Raises
        DriverError.
        """
        read = fresh_state(self.ports, self.limits)
        refused = stopped(self.ports) or (None if standing else read.failure)
        if refused:
            return Outcome(failure=refused)
        start = read.value or self.ports.arms.state()
        with closing(begin(start)) as motion:
            point = _resumed(motion, None)
            if isinstance(point, Outcome):
                return point
            elsewhere = None if point.begins is None else start_mismatch(start, point.begins, self.limits)
            if elsewhere:
                return Outcome(failure=elsewhere)
            return self._drive(motion, point, read.ok, control)

    def _drive(self, motion: Motion[V], point: SetPoint, sends: bool, control: PathControl | None) -> Outcome[V]:
        interruptions = Interruptions(self.ports.clock, self.limits, control, point)
        ticks = Ticks(self.ports)
        while True:
            late, read = self._tick(point, ticks, sends)
            bad = read.failure
            if bad and bad.kind is not FailureKind.STALE_STATE:
                self.last_command.q = None
                return Outcome(failure=bad)
            if bad and interruptions.resting:
                return Outcome(failure=bad)
            state = read.value or self.ports.arms.state()
            ahead = _resumed(motion, Feedback(state, sends and read.ok, late, interruptions.order))
            if isinstance(ahead, Outcome):
                return ahead
            ended = interruptions.judge(ahead, point.q, state, bad)
            if ended:
                return Outcome(failure=ended)
            point = ahead

    def _tick(self, point: SetPoint, ticks: Ticks, sends: bool) -> tuple[bool, Outcome[JointState]]:
        """Whether the tick came so late that the arms have come to rest; and their state, or what is wrong."""
        if sends:
            sent = self.ports.arms.command(point.q, point.qd)
            self.last_command.q = point.q
            return ticks.wait(), followed(self.ports, point.q, sent, self.limits)
        late, halted = ticks.wait(), stopped(self.ports)
        return late, Outcome(failure=halted) if halted else Outcome(self.ports.arms.state())


def _resumed(motion: Motion[V], feedback: Feedback | None) -> SetPoint | Outcome[V]:
    """The motion's next set-point, or how it ended. feedback: None for the first."""
    try:
        return next(motion) if feedback is None else motion.send(feedback)
    except StopIteration as end:
        outcome: Outcome[V] = end.value
        return outcome
