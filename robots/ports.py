"""The ports of a cell's hardware and the values that pass through them.

Units: metres, radians, seconds, newtons, kilograms. Stamps are seconds of the cell's own clock.

Frames
------
base    the robot's base frame: x forward, y left, z up.
table   parallel to base. Its origin is at the height of the table top, directly below the base origin, so a
        point on the table has z = 0. Garments, fold plans and tool paths are in this frame. `T_base_table` maps
        table coordinates to base coordinates (`p_base = T_base_table @ p_table`).
camera  OpenCV's convention: z along the view, x right, y down.
tool    origin between the tips of the pads (the tool centre point); z out of the hand (down when the hand
        points at the table), y in the closing direction of the pads, x along the width of the pads.

Joint vectors have one entry for each joint: those of the left arm, then those of the right arm, each from shoulder
to wrist. Both arms have the same number of joints. In shapes, `joints` is the number of both arms together (14 for
a robot with seven joints in each arm), `arm` that of one arm. Arrays inside a value are read-only.

Every value has a stamp on the clock of `Clock.now()`. Stamps of a port never go back and are never in the future.
A getter never blocks, never raises because a value is late, and never invents a value. The reader judges the age
of the value. A sound device is at most 0.1 s behind (gripper 0.2 s, stop 0.5 s).

One thread uses the ports. Only `Stop.trigger` and `Stop.state` may be called from others.

`foldcell robot check NAME --driver DRIVER` checks a driver against this contract, clause by clause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def frozen(a: NDArray) -> NDArray:
    """Return `a` as a read-only array. It is copied only if it is writeable."""
    a = np.array(a) if a.flags.writeable else a
    a.setflags(write=False)
    return a


class Side(StrEnum):
    """An arm. The robot's left is +y."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def other(self) -> Side:
        return Side.RIGHT if self is Side.LEFT else Side.LEFT


def arm_slice(side: Side, joints: int) -> slice:
    """Return the slice of an arm's joints in a vector of `joints` entries for both arms."""
    half = joints // 2
    return slice(0, half) if side is Side.LEFT else slice(half, joints)


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A pinhole camera without distortion: focal lengths and principal point [px]."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def matrix(self) -> Array:
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One RGB-D picture.

    rgb: (H, W, 3) uint8. depth: (H, W) float32 along the optical axis [m], NaN where the sensor has no value.
    sequence: number of the picture. It distinguishes a frozen camera from a still scene.
    """

    stamp: float
    sequence: int
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: Intrinsics

    @property
    def nbytes(self) -> int:
        """Size of a picture of this camera [bytes]. Reading it does not wait for the pixels."""
        return 7 * self.intrinsics.width * self.intrinsics.height


@dataclass(frozen=True, eq=False)
class JointState:
    """Both arms and the head. q, qd, effort: (joints,) [rad], [rad/s], [Nm]; head_pan [rad]."""

    stamp: float
    q: Array
    qd: Array
    effort: Array
    head_pan: float


@dataclass(frozen=True, eq=False)
class JointSetpoint:
    """The set-point that a driver sent: q, qd (joints,) [rad], [rad/s] after clipping, and whether it clipped."""

    stamp: float
    q: Array
    qd: Array
    clipped: bool


@dataclass(frozen=True, eq=False)
class ArmTrajectory:
    """A synchronous motion of both arms as a table over time.

    t: (n,) [s] from 0, strictly increasing; q, qd, qdd: (n, joints) [rad], [rad/s], [rad/s2]. Between samples q is
    the cubic Hermite interpolant.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    def at(self, t: float) -> tuple[Array, Array]:
        """Return position and velocity (joints,), (joints,) at time t [s], clamped to the ends."""
        if t <= self.t[0]:
            return self.q[0], np.zeros(self.q.shape[1])
        if t >= self.t[-1]:
            return self.q[-1], np.zeros(self.q.shape[1])
        q, qd, _ = self.sampled(np.array([t]))
        return q[0], qd[0]

    def sampled(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, qd and qdd of the interpolant, (m, joints) each, at times t (m,) [s] from start to end."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = (self.t[i + 1] - self.t[i])[:, None]
        s = (t - self.t[i])[:, None] / h
        q0, q1, v0, v1 = self.q[i], self.q[i + 1], self.qd[i] * h, self.qd[i + 1] * h
        c2, c3 = 3 * (q1 - q0) - 2 * v0 - v1, 2 * (q0 - q1) + v0 + v1
        qd, qdd = (v0 + s * (2 * c2 + 3 * s * c3)) / h, (2 * c2 + 6 * s * c3) / h**2
        return q0 + s * (v0 + s * (c2 + s * c3)), qd, qdd


@dataclass(frozen=True)
class GripperState:
    """opening: distance between the pads [m]; force: grip force measured by the gripper [N]. stamp: time of this
    measurement [s], which later commands do not change. in_error: the gripper refuses commands until it is
    calibrated again."""

    stamp: float
    side: Side
    opening: float
    force: float
    moving: bool
    calibrated: bool
    in_error: bool = False


@dataclass(frozen=True, eq=False)
class TactileReading:
    """Normal force on each cell of both pads: (2, rows, columns) [N].

    Pads 0 and 1 face each other along the tool's +y and -y; row 0 is at the tips. tip: (2,) force along the tool's
    z on the two fingertips, from contact with the table or the cloth in a descent [N].
    """

    stamp: float
    side: Side
    cells: Array
    tip: Array

    @property
    def grip(self) -> float:
        """The grip force that both pads measure: the smaller of their sums [N]."""
        return float(self.cells.sum(axis=(1, 2)).min())


@dataclass(frozen=True)
class StopState:
    """Whether a protective or emergency stop holds the robot, and the reason."""

    stamp: float
    stopped: bool
    reason: str = ""


class Clock(Protocol):
    """The cell's time. Time in a simulated world advances only in `sleep_until`."""

    def now(self) -> float: ...

    def sleep_until(self, t: float) -> None: ...


class Arms(Protocol):
    """Both arms as one position-controlled device, commanded at 100 Hz.

    A command is valid for `command_timeout` seconds. Without a new command the arms brake and hold their position,
    with their motors on, also if the program has died.
    """

    command_timeout: float

    def state(self) -> JointState: ...

    def enable(self) -> None:
        """Clear faults and switch the motors on. Raises DriverError if the robot refuses."""

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        """Send one set-point q, qd (joints,) [rad], [rad/s]. Returns the set-point as it was sent: clipped to the
        joints' ranges and velocities, and to one step from the arms or the last set-point (robots/setpoint.py).

        Raises DriverError and moves nothing: STOPPED; STALE_STATE if no joint state has arrived for
        `command_timeout`; HARDWARE_FAULT if the motors are off, or a vector is not finite or lacks a joint."""


class Head(Protocol):
    """The head, which carries the camera. `JointState.head_pan` reports its measured angle, 0 for a fixed head."""

    def command_pan(self, angle: float) -> None:
        """Turn to `angle` [rad], positive to the left. Returns immediately. A fixed head ignores it. Raises
        DriverError for an angle that is not finite."""


class Gripper(Protocol):
    """One electric parallel gripper."""

    side: Side
    max_opening: float

    def calibrate(self) -> None:
        """Close and open the pads once, and clear an error. Returns immediately. `GripperState.calibrated` is true
        when it has ended."""

    def command(self, opening: float, force: float) -> None:
        """Move the pads to `opening` [m] with at most `force` [N]. Returns immediately; from now on
        `GripperState.moving` is true until the pads have arrived. During a calibration the command waits for its
        end. Raises DriverError(GRIPPER_FAULT) for values that are not finite, or without a calibration."""

    def state(self) -> GripperState: ...


class Tactile(Protocol):
    """The pressure cells of one gripper's pads, at 100 Hz."""

    side: Side

    def reading(self) -> TactileReading: ...


class Camera(Protocol):
    def capture(self) -> CameraFrame:
        """Take a still picture: no exposure is older than the request. Its depth is registered to the colours. It
        is the mean of several exposures (robots/depth_averaging.py), so the scene has to be still. Raises
        DriverError(CAMERA_FAULT) if the camera does not answer."""

    def glimpse(self) -> CameraFrame | None:
        """Return a picture for display, without waiting. If there is no picture yet, request one and return None.
        May be called between two set-points of a motion. Raises DriverError as `capture` does."""


class Stop(Protocol):
    """The stop circuit. `trigger` and `state` may be called from any thread and from a signal handler, in every
    state. Stopped arms come to rest within 0.5 s. The stop stays, with its first reason, until `reset`."""

    def trigger(self, reason: str) -> None: ...

    def state(self) -> StopState: ...

    def reset(self) -> None:
        """Leave the stop. Only an operator's request may call this. The arms stay disabled until `enable`."""


class BoardPlace(StrEnum):
    """Places of the calibration board."""

    AWAY = "away"
    SHOWN = "shown"  # held before the camera
    LEFT_HAND = "left_hand"  # between the left gripper's pads
    RIGHT_HAND = "right_hand"


class Attendant(Protocol):
    """The person at the cell, for tasks that the robot cannot do itself."""

    def lay_garment(self) -> None:
        """Ask the person to lay the garment flat on the empty table. Returns when the garment lies there."""

    def bring_board(self, place: BoardPlace) -> None:
        """Ask the person for the calibration board. Returns when it is in place. Each SHOWN asks for a new
        pose."""


@dataclass(frozen=True)
class Ports:
    """All ports of a cell that the executive uses."""

    driver: str
    simulated: bool
    clock: Clock
    arms: Arms
    head: Head
    grippers: Mapping[Side, Gripper]
    tactile: Mapping[Side, Tactile]
    camera: Camera
    stop: Stop
    attendant: Attendant
