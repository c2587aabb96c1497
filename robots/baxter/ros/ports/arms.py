"""Baxter's arms over ROS: joint states in, joint commands out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from foldcell.robots.baxter.names import JOINT_NAMES
from foldcell.robots.baxter.ros.messages import POSITION, RAW_POSITION, load_messages
from foldcell.robots.baxter.ros.ports.latest_message import LatestMessage
from foldcell.robots.baxter.ros.ports.stop import RosStop
from foldcell.robots.baxter.ros.topics import (
    ENABLE,
    INVERSE_DYNAMICS,
    JOINT_COMMAND,
    JOINT_COMMAND_TIMEOUT,
    JOINT_STATE_RATE,
    JOINT_STATES,
    SPEED_RATIO,
)
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Array, Clock, JointSetpoint, JointState, Side, arm_slice, frozen
from foldcell.robots.ros.node import Node
from foldcell.robots.setpoint import clip_setpoint

COMMAND_TIMEOUT = 0.2
STATE_RATE = 100
"""Rate of the joint states [Hz]."""
ENABLE_S = 2.0
TICK_S = 0.05
STEADY = 3
"""Number of ticks in a row at which the motors have to be on: a report of before may arrive late."""
SILENT_S = 1.0
"""Largest age of the robot's state [s]. If it is older, the state of the motors is unknown."""


class RosArms:
    """Baxter's arms. limits: every set-point is clipped to them. raw: use RAW_POSITION, and also send velocity and
    acceleration of each set-point for the robot's inverse dynamics. watch: called with each joint state."""

    def __init__(
        self,
        node: Node,
        clock: Clock,
        stop: RosStop,
        limits: JointLimits,
        raw: bool = False,
        watch: Callable[[JointState], None] = lambda state: None,
    ) -> None:
        messages = load_messages()
        self.command_timeout = COMMAND_TIMEOUT
        self._messages, self._clock, self._stop, self._limits, self._raw = messages, clock, stop, limits, raw
        self._sent: JointSetpoint | None = None
        self.joints = LatestMessage(node, clock, JOINT_STATES, messages.joint_state, _joint_state, watch, True)
        self._enable = node.publisher(ENABLE, messages.bool)
        self._commands = {
            side: node.publisher(JOINT_COMMAND.format(side), messages.joint_command) for side in Side
        }
        self._dynamics = {
            side: node.publisher(INVERSE_DYNAMICS.format(side), messages.joint_trajectory_point) for side in Side
        }
        node.publisher(JOINT_STATE_RATE, messages.uint16, latch=True).publish(messages.uint16(STATE_RATE))
        for side in Side:
            node.publisher(SPEED_RATIO.format(side), messages.float64, latch=True).publish(messages.float64(1.0))
            node.publisher(JOINT_COMMAND_TIMEOUT.format(side), messages.float64, latch=True).publish(
                messages.float64(COMMAND_TIMEOUT)
            )

    def state(self) -> JointState:
        """Return the latest joint state. Before the first message its values are NaN and its stamp is -inf."""
        unknown = frozen(np.full(14, np.nan))
        return self.joints.newest or JointState(-np.inf, unknown, unknown, unknown, np.nan)

    def enable(self) -> None:
        """Switch the motors on. Raises DriverError: STOPPED; HARDWARE_FAULT if the motors stay off."""
        self._refuse_stopped("the arms stay disabled")
        self._sent = None
        begun = self._clock.now()
        until, reports = begun + ENABLE_S, 0
        while self._clock.now() < until:
            self._enable.publish(self._messages.bool(True))
            self._clock.sleep_until(self._clock.now() + TICK_S)
            self._refuse_stopped("the arms stay disabled")
            robot = self._stop.robot.newest
            reports = reports + 1 if robot is not None and robot.stamp > begun and robot.enabled else 0
            if reports == STEADY:
                return
        raise DriverError(
            FailureKind.HARDWARE_FAULT, "the robot does not switch its motors on",
            "check the robot's own display for a fault; `rosrun baxter_tools enable_robot.py -s` shows its state",
        )  # fmt: skip

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        """Send a set-point. Raises DriverError: STOPPED; STALE_STATE if the joint state is too old; HARDWARE_FAULT
        if the motors are off, the robot's state is too old, or a joint vector is invalid."""
        q, qd = np.asarray(q, dtype=np.float64), np.asarray(qd, dtype=np.float64)
        if q.shape != (14,) or qd.shape != (14,) or not (np.isfinite(q).all() and np.isfinite(qd).all()):
            what = f"a set-point needs two finite vectors of 14; the shapes are {q.shape} and {qd.shape}"
            raise DriverError(FailureKind.HARDWARE_FAULT, what)
        self._refuse_stopped("nothing moves")
        now, robot = self._clock.now(), self._stop.robot.newest
        if robot is None or now - robot.stamp > SILENT_S:
            raise DriverError(
                FailureKind.HARDWARE_FAULT, "the robot does not report its state", "check the network to the robot"
            )
        if not robot.enabled:
            raise DriverError(FailureKind.HARDWARE_FAULT, "the motors are off", "enable them first")
        if now - self.state().stamp > COMMAND_TIMEOUT:  # then a command might also arrive late
            raise DriverError(
                FailureKind.STALE_STATE, "the positions of the arms are unknown", "check the network to the robot"
            )
        before = self._last(now)
        setpoint = clip_setpoint(q, qd, before.q, self.state().q, self._limits, now)
        for side in Side:
            part = arm_slice(side, len(JOINT_NAMES))
            self._commands[side].publish(
                self._messages.joint_command(
                    RAW_POSITION if self._raw else POSITION, list(setpoint.q[part]), list(JOINT_NAMES[part])
                )
            )
            if self._raw:
                self._dynamics[side].publish(self._point(setpoint, before, part))
        self._sent = setpoint
        return setpoint

    def _last(self, now: float) -> JointSetpoint:
        """Return the last set-point if it is still valid, otherwise the measured position of the arms."""
        if self._sent is not None and now - self._sent.stamp <= COMMAND_TIMEOUT:
            return self._sent
        return JointSetpoint(now, self.state().q, frozen(np.zeros(14)), False)

    def _point(self, setpoint: JointSetpoint, before: JointSetpoint, part: slice) -> Any:
        step = setpoint.stamp - before.stamp
        qdd = (setpoint.qd - before.qd) / step if step > 1e-3 else np.zeros(14)
        limit = self._limits.acceleration
        return self._messages.joint_trajectory_point(
            positions=list(setpoint.q[part]),
            velocities=list(setpoint.qd[part]),
            accelerations=list(np.clip(qdd, -limit, limit)[part]),
        )

    def _refuse_stopped(self, what: str) -> None:
        stop = self._stop.state()
        if stop.stopped:
            raise DriverError(
                FailureKind.STOPPED, f"{what}: stopped ({stop.reason})", "reset the stop, then enable the arms"
            )


def _joint_state(message: Any, stamp: float) -> JointState | None:
    """Read a message by joint names. Returns None if joints are missing (the grippers also publish on this topic)
    or values are not finite."""
    position = {name: k for k, name in enumerate(message.name)}
    if "head_pan" not in position or any(name not in position for name in JOINT_NAMES):
        return None
    index = [position[name] for name in JOINT_NAMES]
    values = [np.asarray(v, dtype=np.float64) for v in (message.position, message.velocity, message.effort)]
    if any(len(v) != len(message.name) for v in values):
        return None
    q, qd, effort = (frozen(v[index]) for v in values)
    head_pan = float(values[0][position["head_pan"]])
    if not np.isfinite([*q, *qd, *effort, head_pan]).all():
        return None
    return JointState(stamp, q, qd, effort, head_pan)
