"""What holds a motion up or ends it on its way: pause, abort, and failures upon which it is brought to rest."""

from __future__ import annotations

from cell.control.checks import ExecutionLimits, start_mismatch
from cell.control.motion import Order, SetPoint
from cell.control.path_clock import PathControl
from cell.control.ticks import TICK_S
from cell.states.commands import ABORTED
from cell.states.transition_table import Event
from robots.errors import Failure
from robots.ports import Array, Clock, JointState

__all__ = ["Interruptions"]


class Interruptions:
    """Whether a motion runs, is being brought to rest, or rests; kept from tick to tick.

    order: goes to the motion with the next feedback. resting: the motion can be left where it is.
    """

    def __init__(
        self, clock: Clock, limits: ExecutionLimits, control: PathControl | None, first: SetPoint
    ) -> None:
        self._clock, self._limits, self._control = clock, limits, control
        self.order: Order | None = None
        self.resting = first.resting
        self._stopping = False
        self._ending: Failure | None = None
        """Why the motion is being brought to rest, when that is to end it."""
        self._asked: float | None = None
        """When the pause was asked for that is not in the journal yet [s]."""

    def judge(self, ahead: SetPoint, q: Array, state: JointState, stale: Failure | None) -> Failure | None:
        """After a tick: the failure with which the motion ends now, or None while it goes on.

        ahead: its next set-point; q (14,): the one just sent. state: read since, unless that is `stale`.
        """
        self.order, self.resting = None, ahead.resting
        self._ending = self._ending or stale or ahead.failure
        if self._ending is None:
            return self._heed(ahead, q, state)
        if not self.resting:
            self._bring_to_rest()
            return None
        return self._ending

    def _bring_to_rest(self) -> None:
        if not self._stopping:
            self.order, self._stopping = Order.REST, True

    def _heed(self, ahead: SetPoint, q: Array, state: JointState) -> Failure | None:
        """What the operator says to a motion: pause it, go on, end it."""
        control = self._control
        if control is None or control.commands is None:
            return None
        if self.resting:
            return self._rest(control, ahead, q, state)
        if not self._stopping:
            said = control.wanted()
            if said is Event.PAUSE:
                control.tell("coming to rest on the way")
                self._asked = self._clock.now()
                self._bring_to_rest()
            if said is Event.ABORT:
                self._ending = ABORTED
                self._bring_to_rest()
        return None

    def _rest(self, control: PathControl, ahead: SetPoint, q: Array, state: JointState) -> Failure | None:
        """A tick of a pause. It is written down once the arms rest: the disk does not keep moving arms waiting."""
        control.waited_s += TICK_S
        if self._asked is not None:
            control.note("paused", {"asked_s": self._asked, "path_s": ahead.path_s})
            control.tell("paused on the way: resume or abort")
            self._asked = None
        said = control.answer()
        if said is Event.RESUME:
            mismatch = start_mismatch(state, q, self._limits)
            if mismatch:
                return mismatch
            control.note("resumed", {"path_s": ahead.path_s})
            control.tell("going on")
            self.order, self._stopping, self.resting = Order.GO, False, False
        return ABORTED if said is Event.ABORT else None
