"""Baxter's electric gripper over ROS.

The robot handles one command at a time and reports the last command that it handled. The driver repeats each
command until the robot has handled it, and then sends the next one. A newer command replaces the waiting commands,
but never a calibration. A command after a calibration is executed when the calibration has ended.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import dropwhile
from threading import Lock
from typing import Any
from uuid import uuid4

from foldcell.robots.baxter.ros.electric_gripper import (
    CALIBRATE,
    CLEAR_CALIBRATION,
    CONFIGURE,
    FULL_FORCE,
    FULL_OPENING,
    GO,
    HARDWARE_ID,
    RESET,
)
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.ports.latest_message import LatestMessage
from foldcell.robots.baxter.ros.topics import GRIPPER_COMMAND, GRIPPER_STATE
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Clock, GripperState, Side
from foldcell.robots.ros.node import Node

REPEAT_S = 0.05
DEAF_S = 2.0
"""If the robot does not answer for this time, the next command raises an error [s]."""
CALIBRATION_S = 10.0
"""Time after which the driver gives up a calibration or any other unanswered command [s]."""
VELOCITY = 100.0
"""Velocity of the pads [%]."""
DEAD_ZONE = 2.0
"""Position tolerance [% of the stroke]."""


REFUSED = "check whether it is free to move; the next run resets and calibrates it"
DEAF = "check whether the gripper is plugged in and free to move, then start again"


@dataclass(frozen=True)
class _Order:
    """A command in the queue. force: the grip force that it configures [N]; None for other commands."""

    what: str
    message: Any
    force: float | None


class RosGripper:
    """The gripper of one side. max_opening [m]. stopped: returns whether the robot is stopped. A stop cancels the
    waiting orders."""

    def __init__(self, node: Node, clock: Clock, side: Side, stopped: Callable[[], bool] = lambda: False) -> None:
        messages = load_messages()
        self.side, self.max_opening = side, FULL_OPENING
        self._stopped = stopped
        self._clock, self._kind = clock, messages.end_effector_command
        # the robot may still report the last command of an earlier program; a unique sender avoids confusion
        self._sender, self._sequence = f"foldcell_{side}_{uuid4().hex[:12]}", 0
        self._publisher = node.publisher(GRIPPER_COMMAND.format(side), messages.end_effector_command)
        self._lock = Lock()
        self._waiting: tuple[_Order, ...] = ()
        """Orders that are not finished. The robot handles the first one. The tuple is replaced as a whole, so
        `state` needs no lock."""
        self._begun = self._told = -math.inf
        self._calibrating = False
        self._uncalibrated = False
        """Whether the last requested calibration was given up."""
        self._force: float | None = None
        """The grip force that is configured in the robot [N]; None if it is unknown."""
        self._last: tuple[float, float] | None = None
        """Opening [m] and force [N] of the last command."""
        self._fault: DriverError | None = None
        """The last fault, until `command` raises it."""
        self.hearing = LatestMessage(
            node, clock, GRIPPER_STATE.format(side), messages.end_effector_state, _read, self._heard
        )

    def calibrate(self) -> None:
        """Start a calibration. Later commands wait until it ends. Raises DriverError(STOPPED)."""
        self._refuse_stopped()
        with self._lock:
            again = _calibrates(self._waiting)
            self._forget()
            self._fault, self._uncalibrated = None, False
            heard = self.hearing.newest
            if heard is not None and heard[0].error == 1:
                self._add(RESET)
            if again or (heard is not None and heard[0].calibrated == 1):
                self._add(CLEAR_CALIBRATION)  # without it, the end of the new calibration is not visible
            self._add(CALIBRATE)

    def command(self, opening: float, force: float) -> None:
        """Move the pads. Raises DriverError: STOPPED; GRIPPER_FAULT for values that are not finite, or if the
        gripper is not calibrated, does not answer or refused an earlier command."""
        self._refuse_stopped()
        if not (math.isfinite(opening) and math.isfinite(force)):
            raise DriverError(FailureKind.GRIPPER_FAULT, f"invalid command: opening {opening} m, force {force} N")
        with self._lock:
            if self._waiting and self._waited() > (CALIBRATION_S if self._calibrating else DEAF_S):
                self._give_up()
            if self._fault is not None:
                fault, self._fault = self._fault, None
                raise fault
            heard = self.hearing.newest
            calibrated = heard is not None and self._calibrated(heard[0])
            if not (calibrated or _calibrates(self._waiting)):
                self._refuse_stopped()  # the calibration may have been cancelled by a stop
                raise self._error("is not calibrated", "calibrate it first")
            if self._last == (opening, force):
                return
            self._last = opening, force
            self._waiting = _kept(self._waiting)
            configured = [order.force for order in self._waiting if order.force is not None]
            if (configured[-1] if configured else self._force) != force:
                percent = _percent(force, FULL_FORCE)
                figures = {"velocity": VELOCITY, "moving_force": percent, "holding_force": percent}
                self._add(CONFIGURE, json.dumps({**figures, "dead_zone": DEAD_ZONE}), force)
            self._add(GO, json.dumps({"position": _percent(opening, FULL_OPENING)}))

    def state(self) -> GripperState:
        """Return the latest state, with its time of arrival. Before the first message its values are NaN and its
        stamp is -inf. While a command is unhandled, the pads count as moving."""
        waiting = self._waiting  # read before the latest message, which may empty the queue
        heard = self.hearing.newest
        if heard is None:
            return GripperState(-math.inf, self.side, math.nan, math.nan, False, False)
        message, stamp = heard
        return GripperState(
            stamp, self.side, message.position / 100.0 * FULL_OPENING, message.force / 100.0 * FULL_FORCE,
            moving=bool(waiting) or message.moving == 1,
            calibrated=not _calibrates(waiting) and self._calibrated(message),
            in_error=message.error == 1 and not _calibrates(waiting),
        )  # fmt: skip

    def _calibrated(self, message: Any) -> bool:
        return message.calibrated == 1 and not self._uncalibrated

    def _refuse_stopped(self) -> None:
        if self._stopped():
            raise DriverError(
                FailureKind.STOPPED, f"the {self.side} gripper does not move: stopped", "reset the stop first"
            )

    def _waited(self) -> float:
        """Return the time since the first waiting order was sent for the first time [s]."""
        return self._clock.now() - self._begun

    def _forget(self) -> None:
        """Cancel the waiting orders and forget the values that were sent to the robot."""
        self._waiting = ()
        self._calibrating, self._force, self._last = False, None, None

    def _give_up(self) -> None:
        """Cancel the waiting orders. The next command raises the fault."""
        self._uncalibrated = self._uncalibrated or _calibrates(self._waiting)
        self._fault = self._error(f"does not execute the command ({self._waiting[0].what})", DEAF)
        self._forget()

    def _add(self, what: str, arguments: str = "", force: float | None = None) -> None:
        self._sequence = self._sequence % 0x7FFFFFFF + 1
        sender = f"{self._sender}_{self._sequence}"
        message = self._kind(HARDWARE_ID, what, arguments, sender, self._sequence)
        self._waiting = (*self._waiting, _Order(what, message, force))
        if len(self._waiting) == 1:
            self._begin()

    def _begin(self) -> None:
        self._begun = self._clock.now()
        self._tell()

    def _tell(self) -> None:
        self._told = self._clock.now()
        if not self._stopped():
            self._publisher.publish(self._waiting[0].message)

    def _heard(self, heard: tuple[Any, float]) -> None:
        """Called with each state of the gripper. Sends the next order, or repeats the first one."""
        message, _ = heard
        with self._lock:
            if self._stopped():
                self._forget()  # otherwise the robot would execute them after the stop
            if not self._waiting:
                return
            first = self._waiting[0]
            echoed = _echoes(message, first.message)
            self._calibrating = self._calibrating or (echoed and first.what == CALIBRATE)
            if echoed and _done(first.what, message):
                self._advance(first, message)
            elif self._waited() > CALIBRATION_S:
                self._give_up()
            elif not self._calibrating and self._clock.now() - self._told >= REPEAT_S:
                self._tell()

    def _advance(self, done: _Order, message: Any) -> None:
        """Start the next order. If the robot refused to configure a force, the motions with that force are
        dropped."""
        self._calibrating = False
        self._waiting = self._waiting[1:]
        if done.force is not None:
            self._force = done.force
        if message.error == 1 and done.what in (CONFIGURE, GO):
            self._fault = self._error(f"refused to {done.what}: {message.state or 'no reason given'}", REFUSED)
            self._last = None
            if done.what == CONFIGURE:
                self._force = None
                self._waiting = tuple(dropwhile(lambda order: order.what == GO, self._waiting))
        if self._waiting:
            self._begin()

    def _error(self, what: str, hint: str) -> DriverError:
        return DriverError(FailureKind.GRIPPER_FAULT, f"the {self.side} gripper {what}", hint)


def _read(message: Any, stamp: float) -> tuple[Any, float] | None:
    """Return the message and its arrival time; None if a value is not finite."""
    return (message, stamp) if math.isfinite(message.position) and math.isfinite(message.force) else None


def _calibrates(waiting: Sequence[_Order]) -> bool:
    return any(order.what == CALIBRATE for order in waiting)


def _kept(waiting: tuple[_Order, ...]) -> tuple[_Order, ...]:
    """Return the orders that a new command does not replace: the first order, and all orders up to the last
    calibration."""
    last = max((k for k, order in enumerate(waiting) if order.what == CALIBRATE), default=0)
    return waiting[: last + 1]


def _echoes(message: Any, order: Any) -> bool:
    """Whether the robot reports that it has handled the order. It may report sequence 0 instead, as in the SDK."""
    return message.command_sender == order.sender and message.command_sequence in (order.sequence, 0)


def _done(what: str, message: Any) -> bool:
    """Whether a handled order has finished. Most orders have finished as soon as the robot has handled them.
    CALIBRATE and CLEAR_CALIBRATION have finished when the robot's state shows their result."""
    if what == CALIBRATE:
        return bool(message.calibrated == 1 and message.moving != 1 and message.ready != 0)
    return what != CLEAR_CALIBRATION or bool(message.calibrated != 1)


def _percent(value: float, full: float) -> float:
    return 100.0 * min(max(value / full, 0.0), 1.0)
