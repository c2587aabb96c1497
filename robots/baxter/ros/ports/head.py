"""Baxter's head over ROS. The camera is mounted on the head."""

from __future__ import annotations

import math
from collections.abc import Callable

from foldcell.robots.baxter.names import HEAD_RANGE
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.topics import HEAD_COMMAND
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Clock, JointState
from foldcell.robots.ros.node import Node

SPEED = 0.5  # fraction of full speed
REPEAT_S = 0.05
GIVE_UP_S = 5.0
THERE = 0.005
"""Largest error with which an angle counts as reached [rad]."""


class RosHead:
    """The head. A command is repeated until the head has reached the angle or the robot is stopped, for at most
    GIVE_UP_S."""

    def __init__(self, node: Node, clock: Clock, stopped: Callable[[], bool] = lambda: False) -> None:
        self._clock, self._messages, self._stopped = clock, load_messages(), stopped
        self._publisher = node.publisher(HEAD_COMMAND, self._messages.head_pan_command)
        self._goal = math.nan
        self._asked = self._told = -math.inf

    def command_pan(self, angle: float) -> None:
        """Turn the head to `angle` [rad]. Raises DriverError: STOPPED; HARDWARE_FAULT if the angle is not
        finite."""
        if self._stopped():
            raise DriverError(FailureKind.STOPPED, "the head does not move: stopped", "reset the stop first")
        if not math.isfinite(angle):
            raise DriverError(FailureKind.HARDWARE_FAULT, f"invalid angle for the head: {angle}")
        self._goal, self._asked = min(max(angle, -HEAD_RANGE), HEAD_RANGE), self._clock.now()
        self._tell()

    def watch(self, state: JointState) -> None:
        """Repeat the command if necessary. Called with each joint state."""
        if self._stopped():
            self._goal = math.nan
        wanted = self._clock.now() - self._asked < GIVE_UP_S and abs(state.head_pan - self._goal) > THERE
        if wanted and self._clock.now() - self._told >= REPEAT_S:
            self._tell()

    def _tell(self) -> None:
        self._told = self._clock.now()
        kind = self._messages.head_pan_command
        self._publisher.publish(kind(self._goal, SPEED, kind.REQUEST_PAN_ENABLE))
