"""The control loop: sends set-points at 100 Hz, for folds and calibrations alike.

The loop runs a motion (motion.py): it sends a set-point, waits for the next tick, reads and checks the arms'
state, and asks the motion for the next set-point. The loop checks the stop, the state's age, altered set-points,
tracking errors, pause and abort for every motion. The motions check arrival, contact, force and slip.
docs/do/safety.md states the order of the checks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from typing import TypeVar

from foldcell.cell.control.checks import (
    ExecutionLimits,
    FrozenStateWatch,
    followed,
    fresh_state,
    start_mismatch,
    stopped,
)
from foldcell.cell.control.motion import Feedback, Motion, SetPoint
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.pausing import Interruptions
from foldcell.cell.control.set_points import LastCommand, PathRecord
from foldcell.cell.control.ticks import TICK_S, Ticks
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, JointState, Ports
from foldcell.skills.vocabulary import Outcome

V = TypeVar("V")


@dataclass(frozen=True, eq=False)
class ControlLoop:
    """The control loop. last_command: carries the last set-point over from one motion to the next. path: records
    the set-points."""

    ports: Ports
    limits: ExecutionLimits
    last_command: LastCommand
    path: PathRecord = field(default_factory=PathRecord)

    def run(
        self,
        begin: Callable[[JointState], Motion[V]],
        control: PathControl | None = None,
        standing: bool = False,
    ) -> Outcome[V]:
        """Run the motion that `begin` makes from the arms' state.

        control: lets the operator pause or abort the motion. standing: the motion only holds the arms, so it may
        start even if the state is stale. In this case no set-points are sent, and the driver holds the arms after
        its command timeout.

        Failures: the motion's own; STOPPED, STALE_STATE, START_MISMATCH, LIMIT_EXCEEDED (an altered set-point),
        TRACKING_ERROR, ABORTED. Raises DriverError.
        """
        read = fresh_state(self.ports, self.limits)
        failure = stopped(self.ports) or (None if standing else read.failure)
        if failure:
            return Outcome(failure=failure)
        start = read.value or self.ports.arms.state()
        with closing(begin(start)) as motion:
            point = _next_setpoint(motion, None)
            if isinstance(point, Outcome):
                return point
            failure = None if point.begins is None else start_mismatch(start, point.begins, self.limits)
            if failure:
                return Outcome(failure=failure)
            return self._drive(motion, point, read.ok, control)

    def _drive(self, motion: Motion[V], point: SetPoint, sends: bool, control: PathControl | None) -> Outcome[V]:
        interruptions = Interruptions(self.ports.clock, self.limits, control, point)
        ticks, watch = Ticks(self.ports), FrozenStateWatch()
        under_way = deque[Array](maxlen=round(self.limits.latency_s / TICK_S))
        while True:
            late, read = self._tick(point, ticks, sends, under_way)
            under_way.append(point.q)
            frozen = watch.check(read.unwrap(), point.q) if sends and read.ok else None
            if frozen:
                read = Outcome(failure=frozen)
            failure = read.failure
            stale = failure is not None and failure.kind is FailureKind.STALE_STATE
            if failure and not stale:
                self.last_command.q = None
            if failure and (interruptions.resting or not stale):
                if failure.kind is FailureKind.STOPPED or not interruptions.paused:
                    return Outcome(failure=failure)
                sends = False  # until the operator resumes, the driver holds the arms
            state = read.value or self.ports.arms.state()
            following = _next_setpoint(motion, Feedback(state, sends and read.ok, late, interruptions.order))
            if isinstance(following, Outcome):
                return following
            ending = interruptions.judge(following, point.q, state, failure)
            if ending:
                return Outcome(failure=ending)
            point = following

    def _tick(
        self, point: SetPoint, ticks: Ticks, sends: bool, under_way: deque[Array]
    ) -> tuple[bool, Outcome[JointState]]:
        """Perform one tick. under_way: the set-points of the last ticks. Returns whether the tick came so late
        that the arms have come to rest, and their state or a failure."""
        if sends:
            sent = self.ports.arms.command(point.q, point.qd)
            self.last_command.q = point.q
            self.path.add(point.q)
            late = ticks.wait()
            return late, followed(self.ports, point.q, sent, self.limits, late, under_way)
        late, failure = ticks.wait(), stopped(self.ports)
        return late, Outcome(failure=failure) if failure else Outcome(self.ports.arms.state())


def _next_setpoint(motion: Motion[V], feedback: Feedback | None) -> SetPoint | Outcome[V]:
    """Return the motion's next set-point, or its outcome if it has ended. feedback: None for the first
    set-point."""
    try:
        return next(motion) if feedback is None else motion.send(feedback)
    except StopIteration as end:
        outcome: Outcome[V] = end.value
        return outcome
