"""Baxter's stop over ROS: the robot's own stop, and the stop that this program requests.

An observed or requested stop remains until it is reset, even if the robot meanwhile reports that it is not
stopped.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
from dataclasses import dataclass
from typing import Any

from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.ports.latest_message import LatestMessage
from foldcell.robots.baxter.ros.topics import RESET, ROBOT_STATE, STOP
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Clock, StopState
from foldcell.robots.ros.node import Node

REPEAT_S = 0.02
CLOSE_S = 0.5
"""Longest wall time for which `close` repeats a stop that the robot has not confirmed [s]."""
RESET_S = 3.0
TICK_S = 0.05
PRESSED = 1
SOURCES = {
    1: "the emergency button was pressed",
    3: "a joint's fault stopped the robot",
    4: "the robot's own computer stopped answering",
}


@dataclass(frozen=True)
class AssemblyState:
    """State that the robot reports. stamp: time of arrival [s]."""

    stamp: float
    enabled: bool
    stopped: bool
    error: bool
    button: int
    source: int


class RosStop:
    """The stop circuit. `trigger` writes one byte to a pipe, so it may be called from a signal handler. A thread
    then repeats the stop command until the robot has stopped."""

    def __init__(self, node: Node, clock: Clock) -> None:
        messages = load_messages()
        self._clock, self._empty = clock, messages.empty
        self._stop, self._reset = node.publisher(STOP, messages.empty), node.publisher(RESET, messages.empty)
        self._observed: StopState | None = None
        self._requested: StopState | None = None
        self._resetting: StopState | None = None
        """The requested stop that is being reset. It is no longer sent to the robot."""
        self._lifted: StopState | None = None
        """The requested stop that has been reset."""
        self.robot = LatestMessage(node, clock, ROBOT_STATE, messages.assembly_state, _assembly, self._watch)
        self._wake, self._wakener = os.pipe()
        os.set_blocking(self._wakener, False)  # if the pipe is full, earlier triggers wake the thread
        self._until = math.inf
        self._thread = threading.Thread(target=self._insist, name="stop", daemon=True)
        self._thread.start()

    def trigger(self, reason: str) -> None:
        """Request a stop. May be called from any thread and from a signal handler."""
        if self._requested is self._lifted or self._requested is self._resetting:
            self._requested = StopState(self._clock.now(), True, reason or "no reason given")
        self._wake_thread(b"s")

    def state(self) -> StopState:
        """The state of the stop. Its stamp is the time at which the stop was requested or observed. Without a stop
        it is the time of the last message."""
        requested, robot = self._requested, self.robot.newest
        if requested is not None and requested is not self._lifted:
            return requested
        return self._observed or StopState(-math.inf if robot is None else robot.stamp, False)

    def reset(self) -> None:
        """Leave the stop. Raises DriverError(STOPPED) and stays stopped if the button is still pressed, the robot
        does not leave its stop, or another stop occurs in the meantime."""
        robot = self.robot.newest
        if robot is not None and robot.button == PRESSED:
            raise DriverError(
                FailureKind.STOPPED, "the emergency button is still pressed", "turn it until it springs back"
            )
        resetting = self._resetting = self._requested
        try:
            self._leave(resetting)
            self._lifted, self._observed = resetting, None
        finally:
            self._resetting = self._lifted
            self._wake_thread(b"s")  # send a new stop, if there is one

    def close(self) -> None:
        """Close the port. If the robot has not confirmed a stop, first repeat the stop for up to CLOSE_S."""
        if self._until == math.inf:
            self._until = time.monotonic() + CLOSE_S
            self._wake_thread(b"c")
            self._thread.join()
            wakener, self._wakener = self._wakener, -1
            os.close(wakener)
            os.close(self._wake)

    def _leave(self, resetting: StopState | None) -> None:
        """Repeat the reset command until the robot reports that it has left its stop with its motors off."""
        begun = self._clock.now()
        while self._clock.now() < begun + RESET_S:
            self._reset.publish(self._empty())
            self._clock.sleep_until(self._clock.now() + TICK_S)
            requested, robot = self._requested, self.robot.newest
            if requested is not None and requested is not resetting:
                raise DriverError(
                    FailureKind.STOPPED,
                    f"stopped again during the reset ({requested.reason})",
                    "reset it once more",
                )
            if robot is None or robot.stamp <= begun:
                continue
            if not (robot.stopped or robot.error or robot.enabled):
                return
        robot = self.robot.newest
        if robot is not None and robot.stamp > begun and not (robot.stopped or robot.enabled):
            return  # the remaining error is not part of the stop and does not prevent enabling
        raise DriverError(
            FailureKind.STOPPED, "the robot does not leave its stop", "check the robot's display, then reset again"
        )

    def _wake_thread(self, what: bytes) -> None:
        with contextlib.suppress(OSError):  # the pipe is full, or was closed together with the cell
            os.write(self._wakener, what)

    def _watch(self, robot: AssemblyState) -> None:
        if robot.stopped and self._observed is None:
            why = SOURCES.get(robot.source, "the robot reports that it is stopped")
            self._observed = StopState(robot.stamp, True, why)

    def _insist(self) -> None:
        """Repeat the stop command until the robot reports that it has stopped."""
        while os.read(self._wake, 1) == b"s":
            while self._unconfirmed() and time.monotonic() < self._until:
                self._stop.publish(self._empty())
                time.sleep(REPEAT_S)
            if self._until < math.inf:
                return

    def _unconfirmed(self) -> bool:
        requested, robot = self._requested, self.robot.newest
        if requested is None or requested is self._lifted or requested is self._resetting:
            return False
        return robot is None or not robot.stopped or robot.stamp <= requested.stamp


def _assembly(message: Any, stamp: float) -> AssemblyState:
    return AssemblyState(
        stamp, message.enabled, message.stopped, message.error, message.estop_button, message.estop_source
    )
