"""Baxter's electric gripper over ROS.

The robot handles one command at a time and says which one it handled last: each is repeated until it has, and only
then the next one follows.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import Any
from uuid import uuid4

from robots.baxter.ros.clock import RosClock
from robots.baxter.ros.electric_gripper import (
    CALIBRATE,
    CLEAR_CALIBRATION,
    CONFIGURE,
    FULL_FORCE,
    FULL_OPENING,
    GO,
    HARDWARE_ID,
    RESET,
)
from robots.baxter.ros.hearing import Hearing
from robots.baxter.ros.messages import load_messages
from robots.baxter.ros.node import Node
from robots.baxter.ros.topics import gripper_command, gripper_state
from robots.errors import DriverError, FailureKind
from robots.ports import GripperState, Side

__all__ = ["RosGripper"]

REPEAT_S = 0.05
DEAF_S = 2.0
"""A command that was not handled for so long never will be."""
CALIBRATION_S = 10.0
VELOCITY = 100.0
"""[%]"""
DEAD_ZONE = 2.0
"""[%] of the stroke within which a position counts as reached."""


@dataclass(frozen=True)
class _Order:
    """A command that is to be handled. force [N]: that it configures."""

    what: str
    message: Any
    force: float | None


class RosGripper:
    """One gripper, `side`'s. max_opening [m]. stopped: whether the robot is; orders that wait are void then."""

    def __init__(
        self, node: Node, clock: RosClock, side: Side, stopped: Callable[[], bool] = lambda: False
    ) -> None:
        messages = load_messages()
        self.side, self.max_opening = side, FULL_OPENING
        self._stopped = stopped
        self._clock, self._kind = clock, messages.end_effector_command
        # the robot echoes the last command of whoever was here before: it is never taken for one of these
        self._sender, self._sequence = f"foldcell_{side}_{uuid4().hex[:12]}", 0
        self._publisher = node.publisher(gripper_command(side), messages.end_effector_command)
        self._lock = Lock()
        self._waiting: deque[_Order] = deque()
        self._begun = self._told = -math.inf
        self._calibrating = False
        self._force: float | None = None
        """That the robot was configured to squeeze with [N]."""
        self._last: tuple[float, float] | None = None
        """Opening and force that were commanded last."""
        self._refused: str | None = None
        """What it would not do, and why, until somebody was told."""
        self.hearing = Hearing(
            node, clock, gripper_state(side), messages.end_effector_state, lambda m, t: (m, t), self._heard
        )

    def calibrate(self) -> None:
        """What is commanded meanwhile follows after it. Raises DriverError(STOPPED)."""
        self._refuse_stopped()
        with self._lock:
            self._forget()
            self._refused = None
            heard = self.hearing.newest
            if heard is not None and heard[0].error == 1:
                self._add(RESET)
            if heard is not None and heard[0].calibrated == 1:
                self._add(CLEAR_CALIBRATION)  # else nobody could tell when the new one is done
            self._add(CALIBRATE)

    def command(self, opening: float, force: float) -> None:
        """Raises DriverError: STOPPED; GRIPPER_FAULT for no numbers, and when it is not calibrated, does not
        answer, or refused what it was told before."""
        self._refuse_stopped()
        if not (math.isfinite(opening) and math.isfinite(force)):
            raise DriverError(FailureKind.GRIPPER_FAULT, f"no command: opening {opening} m, force {force} N")
        with self._lock:
            now = self._clock.now()
            if self._waiting and now - self._begun > (CALIBRATION_S if self._calibrating else DEAF_S):
                what = self._waiting[0].what
                self._forget()
                raise DriverError(
                    FailureKind.GRIPPER_FAULT,
                    f"the {self.side} gripper does not do what it is told ({what})",
                    "see whether the gripper is plugged in and free to move, then start again",
                )
            heard = self.hearing.newest
            calibrated = heard is not None and heard[0].calibrated == 1
            if not calibrated and not any(order.what == CALIBRATE for order in self._waiting):
                self._refuse_stopped()  # a stop that came meanwhile has made the order void
                raise DriverError(
                    FailureKind.GRIPPER_FAULT, f"the {self.side} gripper is not calibrated", "calibrate it first"
                )
            if self._refused is not None:
                why, self._refused = self._refused, None
                raise DriverError(
                    FailureKind.GRIPPER_FAULT, f"the {self.side} gripper refused to {why}",
                    "see whether it is free to move; the next run resets and calibrates it",
                )  # fmt: skip
            if self._last == (opening, force):
                return
            self._last = opening, force
            self._waiting = deque(list(self._waiting)[:1])  # it is under way; what else waits is out of date
            ahead = self._waiting[0].force if self._waiting else None
            if (self._force if ahead is None else ahead) != force:
                percent = _percent(force, FULL_FORCE)
                figures = {"velocity": VELOCITY, "moving_force": percent, "holding_force": percent}
                self._add(CONFIGURE, json.dumps({**figures, "dead_zone": DEAD_ZONE}), force)
            self._add(GO, json.dumps({"position": _percent(opening, FULL_OPENING)}))

    def state(self) -> GripperState:
        """As last heard; before that of no time. A command that was not handled yet counts as a motion."""
        heard = self.hearing.newest
        if heard is None:
            return GripperState(-math.inf, self.side, math.nan, math.nan, False, False)
        message, stamp = heard
        return GripperState(
            stamp, self.side, message.position / 100.0 * FULL_OPENING, message.force / 100.0 * FULL_FORCE,
            moving=bool(self._waiting) or message.moving == 1,
            calibrated=message.calibrated == 1 and all(order.what != CALIBRATE for order in tuple(self._waiting)),
        )  # fmt: skip

    def _refuse_stopped(self) -> None:
        if self._stopped():
            raise DriverError(
                FailureKind.STOPPED, f"the {self.side} gripper stays as it is: stopped", "reset the stop first"
            )

    def _forget(self) -> None:
        """What was not handled is not wanted any more."""
        self._waiting.clear()
        self._calibrating, self._force, self._last = False, None, None

    def _add(self, what: str, arguments: str = "", force: float | None = None) -> None:
        self._sequence = self._sequence % 0x7FFFFFFF + 1
        message = self._kind(HARDWARE_ID, what, arguments, self._sender, self._sequence)
        self._waiting.append(_Order(what, message, force))
        if len(self._waiting) == 1:
            self._begin()

    def _begin(self) -> None:
        self._begun = self._clock.now()
        self._tell()

    def _tell(self) -> None:
        self._told = self._clock.now()
        self._publisher.tell(self._waiting[0].message)

    def _heard(self, heard: tuple[Any, float]) -> None:
        """After each state of the gripper: on to the next command, or the same once more."""
        message, _ = heard
        with self._lock:
            if self._waiting and self._stopped():
                self._forget()  # else it would be done whenever the robot can do it again
            if not self._waiting:
                return
            first = self._waiting[0]
            theirs = message.command_sender, message.command_sequence
            handled = theirs == (self._sender, first.message.sequence)
            if handled and first.what == CALIBRATE:
                self._calibrating = True
                handled = message.calibrated == 1 and message.moving != 1 and message.ready != 0
            if handled:
                self._calibrating = False
                self._waiting.popleft()
                if message.error == 1 and first.what == GO:
                    self._refused, self._last = f"{first.what}: {message.state or 'no reason given'}", None
                self._force = self._force if first.force is None else first.force
                if self._waiting:
                    self._begin()
            elif not self._calibrating and self._clock.now() - self._told >= REPEAT_S:
                self._tell()


def _percent(value: float, full: float) -> float:
    return 100.0 * min(max(value / full, 0.0), 1.0)
