"""What a cell's hardware is, seen from above: the ports and the values that pass them.

Units: metres, radians, seconds, newtons, kilograms. Stamps are seconds of the cell's own clock.

Frames
------
base    the robot's base frame: x forward, y left, z up.
table   parallel to base, its origin on the table's top right below the base origin: a point on the
        table has z = 0. Garments, fold plans and tool paths are stated in it. `T_base_table` maps
        table coordinates to base coordinates (`p_base = T_base_table @ p_table`).
camera  OpenCV's: z along the view, x right, y down.
tool    origin between the pads' tips (the tool centre point); z out of the hand (down when it points
        at the table), y along which the pads close, x along the pads' width: the line that holds.

Joint vectors have 14 entries: the left arm's seven, then the right arm's seven, each from shoulder to
wrist. Arrays inside a value are read-only.

Every value carries its stamp; a getter never blocks, never raises for being late, never makes a value
up: who reads it judges its age.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ArmTrajectory",
    "Arms",
    "Array",
    "Attendant",
    "BoardPlace",
    "Camera",
    "CameraFrame",
    "Clock",
    "Gripper",
    "GripperState",
    "Head",
    "Intrinsics",
    "JointSetpoint",
    "JointState",
    "Ports",
    "Side",
    "Stop",
    "StopState",
    "Tactile",
    "TactileReading",
    "arm_slice",
    "frozen",
]

Array = NDArray[np.float64]


def frozen(a: NDArray) -> NDArray:
    """`a` as a read-only array (copied only if someone else could write it)."""
    a = np.array(a) if a.flags.writeable else a
    a.setflags(write=False)
    return a


class Side(StrEnum):
    """Which arm. The robot's left is +y."""

    LEFT = "left"
    RIGHT = "right"

    @property
    def other(self) -> Side:
        return Side.RIGHT if self is Side.LEFT else Side.LEFT


def arm_slice(side: Side) -> slice:
    """Where an arm's seven joints stand in a 14-joint vector."""
    return slice(0, 7) if side is Side.LEFT else slice(7, 14)


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

    rgb: (H, W, 3) uint8. depth: (H, W) float32 [m] along the optical axis, NaN where the sensor saw
    nothing. sequence: counts pictures, so that a frozen camera can be told from a still scene.
    """

    stamp: float
    sequence: int
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: Intrinsics


@dataclass(frozen=True, eq=False)
class JointState:
    """Both arms and the head. q, qd, effort: (14,) [rad], [rad/s], [Nm]; head_pan [rad]."""

    stamp: float
    q: Array
    qd: Array
    effort: Array
    head_pan: float


@dataclass(frozen=True, eq=False)
class JointSetpoint:
    """What a driver really sent: q, qd (14,) after its own clipping, and whether it clipped."""

    stamp: float
    q: Array
    qd: Array
    clipped: bool


@dataclass(frozen=True, eq=False)
class ArmTrajectory:
    """A motion of both arms on one clock, as a table over time.

    t: (n,) [s] from 0, strictly increasing; q, qd, qdd: (n, 14). Between samples q is the cubic Hermite
    interpolant. Planners make it; the runner checks it and streams it.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    def at(self, t: float) -> tuple[Array, Array]:
        """Position and velocity (14,), (14,) at time t [s], clamped to the ends."""
        if t <= self.t[0]:
            return self.q[0], np.zeros(self.q.shape[1])
        if t >= self.t[-1]:
            return self.q[-1], np.zeros(self.q.shape[1])
        i = int(np.searchsorted(self.t, t, side="right")) - 1
        h = self.t[i + 1] - self.t[i]
        s = (t - self.t[i]) / h
        q0, q1, v0, v1 = self.q[i], self.q[i + 1], self.qd[i] * h, self.qd[i + 1] * h
        c2, c3 = 3 * (q1 - q0) - 2 * v0 - v1, 2 * (q0 - q1) + v0 + v1
        return q0 + s * (v0 + s * (c2 + s * c3)), (v0 + s * (2 * c2 + 3 * s * c3)) / h


@dataclass(frozen=True)
class GripperState:
    """opening: between the pads [m]; force: between the pads as the gripper measures it [N]. stamp: when that was
    read or heard [s], however long ago; what was commanded since does not renew it. in_error: it refuses what it
    is told until it is calibrated anew."""

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

    pads 0 and 1 face each other along the tool's +y and -y; row 0 is at the tips. `tip`: force along
    the tool's z on the two fingertips, (2,) [N]: what meets the table or the cloth in a descent.
    """

    stamp: float
    side: Side
    cells: Array
    tip: Array

    @property
    def grip(self) -> float:
        """The force that both pads feel [N]: the smaller of their sums."""
        return float(self.cells.sum(axis=(1, 2)).min())


@dataclass(frozen=True)
class StopState:
    """Whether the robot is held by its protective or emergency stop, and why."""

    stamp: float
    stopped: bool
    reason: str = ""


class Clock(Protocol):
    """The cell's time. In simulation only `sleep_until` lets the world go on."""

    def now(self) -> float: ...

    def sleep_until(self, t: float) -> None: ...


class Arms(Protocol):
    """Both arms as one device of 14 joints, position controlled, commanded at 100 Hz.

    A command holds for `command_timeout` seconds; without a new one the arms hold where they are.
    """

    command_timeout: float

    def state(self) -> JointState: ...

    def enable(self) -> None:
        """Clear faults and switch the motors on. Raises DriverError when the robot refuses."""

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        """Send one set-point (14,), (14,); returns what was really sent."""


class Head(Protocol):
    """The head carries the camera. Its angle is read in `JointState.head_pan`."""

    def command_pan(self, angle: float) -> None: ...


class Gripper(Protocol):
    """One electric parallel gripper."""

    side: Side
    max_opening: float

    def calibrate(self) -> None: ...

    def command(self, opening: float, force: float) -> None:
        """Move the pads to `opening` [m] apart, squeezing with at most `force` [N]. Returns at once."""

    def state(self) -> GripperState: ...


class Tactile(Protocol):
    """The pressure cells of one gripper's pads, 100 Hz."""

    side: Side

    def reading(self) -> TactileReading: ...


class Camera(Protocol):
    def capture(self) -> CameraFrame:
        """Take a still picture now, its depth the mean of some exposures (robots/depth_averaging.py): what is
        looked at has to lie still. Raises DriverError(CAMERA_FAULT) when the camera does not answer."""

    def glimpse(self) -> CameraFrame | None:
        """A picture for show, without waiting: None where there is none yet, and then one is asked for. What a
        motion under way may ask for between two set-points. Raises DriverError as `capture`."""


class Stop(Protocol):
    """The stop circuit: out of band, callable from any thread and from a signal handler."""

    def trigger(self, reason: str) -> None: ...

    def state(self) -> StopState: ...

    def reset(self) -> None:
        """Leave the stop. Only ever called for an operator; the arms stay disabled until `enable`."""


class BoardPlace(StrEnum):
    """Where the calibration board is."""

    AWAY = "away"
    SHOWN = "shown"  # held before the camera
    LEFT_HAND = "left_hand"  # between the left gripper's pads
    RIGHT_HAND = "right_hand"


class Attendant(Protocol):
    """The person at the cell, for what the robot cannot do itself."""

    def lay_garment(self) -> None:
        """Ask for the garment to be laid flat on the empty table; returns when it lies there."""

    def bring_board(self, place: BoardPlace) -> None:
        """Ask for the calibration board; returns when it is there. SHOWN again means: in another pose."""


@dataclass(frozen=True)
class Ports:
    """All that an executive can see and touch of a cell."""

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
