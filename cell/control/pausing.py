"""Interruptions of a motion: pause, abort, and failures that bring it to rest.

Arms that rest in a pause stay at rest until the operator resumes or ends the run, because a person may be near
them. A failure in a pause therefore ends the motion only then. Only the stop ends it at once.
"""

from __future__ import annotations

from foldcell.cell.control.checks import ExecutionLimits, start_mismatch
from foldcell.cell.control.motion import Order, SetPoint
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.states.commands import ABORTED, CommandQueue
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure
from foldcell.robots.ports import Array, Clock, JointState


class Interruptions:
    """Tracks whether a motion runs, is being brought to rest, or rests.

    order: order for the motion, sent with the next feedback. resting: whether the motion may end where it is.
    """

    def __init__(
        self, clock: Clock, limits: ExecutionLimits, control: PathControl | None, first: SetPoint
    ) -> None:
        self._clock, self._limits, self._control = clock, limits, control
        self.order: Order | None = None
        self.resting = first.resting
        self.paused = False
        """Whether the operator has ordered a pause, and not to go on since."""
        self._stopping = False
        self._ending: Failure | None = None
        """The failure that ends the motion once it rests, after a pause once the operator lets it go on."""
        self._told = False
        """Whether the operator knows of a failure in this pause."""
        self._asked: float | None = None
        """Cell time at which a pause was requested [s]; None if no request waits to be written to the journal."""

    def judge(self, following: SetPoint, q: Array, state: JointState, failed: Failure | None) -> Failure | None:
        """Evaluate one tick. Returns the failure that ends the motion now, or None while it continues.

        following: the motion's next set-point; q (joints,): the set-point just sent; state: the arms' state;
        failed: the failure of the loop's own checks, for example of a state that is too old.
        """
        self.order, self.resting = None, following.resting
        self._ending = self._ending or failed or following.failure
        if self._ending is None or (self.paused and self.resting):
            return self._obey_operator(following, q, state)
        if not self.resting:
            self._bring_to_rest()
            return None
        return self._ending

    def _bring_to_rest(self) -> None:
        if not self._stopping:
            self.order, self._stopping = Order.REST, True

    def _obey_operator(self, following: SetPoint, q: Array, state: JointState) -> Failure | None:
        """Obey the operator's commands: pause, resume, abort."""
        control = self._control
        if control is None or control.commands is None:
            return None
        if self.resting:
            return self._rest(control, control.commands, following, q, state)
        if not self._stopping:
            command = control.commands.take(frozenset({Event.PAUSE, Event.ABORT}))
            if command is Event.PAUSE:
                control.tell("pausing: the arms are coming to rest")
                self._asked, self.paused = self._clock.now(), True
                self._bring_to_rest()
            if command is Event.ABORT:
                self._ending = ABORTED
                self._bring_to_rest()
        return None

    def _rest(
        self, control: PathControl, commands: CommandQueue, following: SetPoint, q: Array, state: JointState
    ) -> Failure | None:
        """Perform one tick of a pause, which waits as long for a command in real time. The journal gets the pause
        only when the arms rest, because a slow disk must not delay moving arms."""
        control.waited_s += TICK_S
        if self._asked is not None:
            control.note("paused", {"asked_s": self._asked, "path_s": following.path_s})
            control.tell("paused during a motion: resume, or end the run")
            self._asked = None
        if self._ending and not self._told:
            control.tell(f"{self._ending.what}: nothing moves until you resume, and the cell then recovers")
            self._told = True
        command = commands.wait(frozenset({Event.RESUME, Event.ABORT}), TICK_S)
        if command is Event.RESUME:
            if self._ending:
                return self._ending
            mismatch = start_mismatch(state, q, self._limits)
            if mismatch:
                return mismatch
            control.note("resumed", {"path_s": following.path_s})
            control.tell("resumed")
            self.order, self._stopping, self.resting, self.paused = Order.GO, False, False, False
        return ABORTED if command is Event.ABORT else None
