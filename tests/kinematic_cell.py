"""A sound driver of a cell without dynamics: the arms follow their set-points at full speed at most, and brake
when they get none. It keeps every clause of the ports' contract, so that a test can break one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, cast

import numpy as np

from foldcell.calibration.board import BOARD
from foldcell.cell.hardware.contract.rig import Rig
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import (
    Array,
    BoardPlace,
    CameraFrame,
    GripperState,
    JointSetpoint,
    JointState,
    Ports,
    Side,
    StopState,
    TactileReading,
    frozen,
)
from foldcell.robots.setpoint import clip_setpoint
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.vocabulary import CameraCalibration, Table

STEP = 0.005  # [s]
BRAKE = 6.0  # [rad/s2]
FOLLOW = 0.02  # time constant of the arms [s]
CALIBRATION_S, PAD_SPEED, HEAD_SPEED, LARGEST = 1.0, 0.1, 0.6, 0.04


class KinematicCell:
    """The state behind the ports."""

    command_timeout = 0.2

    def __init__(
        self, model: RobotModel, camera: CameraCalibration, depth: Callable[[CameraFrame], Array], table: float
    ) -> None:
        """depth: makes the depth of a picture. table: height of the table in the base frame [m]."""
        self.table = table
        self.model, self.camera, self._depth = model, camera, depth
        self.t, self.pictures, self.board = 0.0, 0, False
        self.q, self.qd = np.array(model.q_park), np.zeros(len(model.q_park))
        self.setpoint: JointSetpoint | None = None
        self.enabled, self.reason = False, ""
        self.stop_at = 0.0
        self.pan = self.pan_goal = 0.3
        self.unheard_until = -1.0
        self.last = self.state()
        self.hands = {side: _Hand(self, side) for side in Side}

    # clock

    def now(self) -> float:
        return self.t

    def sleep_until(self, t: float) -> None:
        while self.t < t - 1e-9:
            self.t = min(t, self.t + STEP)
            self._step()

    def _step(self) -> None:
        if self.reason:
            self.enabled, self.setpoint = False, None
        if self.setpoint is not None and self.t - self.setpoint.stamp > self.command_timeout:
            self.setpoint = None
        sent, wanted = self.setpoint, np.zeros_like(self.q)
        if sent is not None:
            goal = sent.q + min(self.t - sent.stamp, FOLLOW) * sent.qd
            wanted = (goal - self.q) / FOLLOW + (sent.qd if self.t - sent.stamp < FOLLOW else 0.0)
        reach = BRAKE * STEP if self.setpoint is None else np.inf
        top = self.model.protective.velocity
        self.qd = np.clip(np.clip(wanted, self.qd - reach, self.qd + reach), -top, top)
        self.q = self.q + STEP * self.qd
        self.pan += np.clip(self.pan_goal - self.pan, -HEAD_SPEED * STEP, HEAD_SPEED * STEP)
        for hand in self.hands.values():
            hand.step()

    # arms and head

    def state(self) -> JointState:
        if self.t > self.unheard_until:
            q = self.q + 1e-6 * np.cos(1e3 * self.t)  # encoders have noise
            self.last = JointState(self.t, frozen(q), frozen(self.qd.copy()), frozen(np.zeros_like(q)), self.pan)
        return self.last

    def enable(self) -> None:
        self._refuse_stopped()
        self.enabled = True

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        self._refuse_stopped()
        if not self.enabled or q.shape != self.q.shape or not np.isfinite([q, qd]).all():
            raise DriverError(FailureKind.HARDWARE_FAULT, "off, or not finite vectors")
        if self.t - self.state().stamp > self.command_timeout:
            raise DriverError(FailureKind.STALE_STATE, "no joint state")
        before = self.q if self.setpoint is None else self.setpoint.q
        self.setpoint = clip_setpoint(q, qd, before, self.q, self.model.protective, self.t)
        return self.setpoint

    def command_pan(self, angle: float) -> None:
        if not np.isfinite(angle):
            raise DriverError(FailureKind.HARDWARE_FAULT, "not finite")
        self.pan_goal = angle

    # stop

    def trigger(self, reason: str) -> None:
        self.reason, self.stop_at = self.reason or reason, self.t

    def stop_state(self) -> StopState:
        return StopState(self.stop_at if self.reason else self.t, bool(self.reason), self.reason)

    def reset(self) -> None:
        self.reason, self.enabled = "", False

    def _refuse_stopped(self) -> None:
        if self.reason:
            raise DriverError(FailureKind.STOPPED, self.reason)

    # camera

    def capture(self) -> CameraFrame:
        self.sleep_until(self.t + 0.1)
        return self.glimpse()

    def glimpse(self) -> CameraFrame:
        k = self.camera.intrinsics
        self.pictures += 1
        rgb = np.full((k.height, k.width, 3), self.pictures % 256, np.uint8)
        if self.board:
            card = BOARD.image(1500.0)
            rgb[: card.shape[0], : card.shape[1]] = card[..., None]
        frame = CameraFrame(self.t, self.pictures, frozen(rgb), np.zeros((0, 0), np.float32), k)
        return replace(frame, depth=frozen(self._depth(frame).astype(np.float32)))

    def bring_board(self, place: BoardPlace) -> None:
        self.board = place is BoardPlace.SHOWN

    def ports(self) -> Ports:
        stop: Any = _Named(trigger=self.trigger, state=self.stop_state, reset=self.reset)
        pads = {side: _Named(side=side, reading=hand.reading) for side, hand in self.hands.items()}
        attendant: Any = _Named(bring_board=self.bring_board)
        return Ports(
            "kinematic", True, self, self, self, self.hands, cast(Mapping[Side, Any], pads), self, stop, attendant
        )


class _Named:
    def __init__(self, **own: Any) -> None:
        self.__dict__.update(own)


class _Hand:
    max_opening = LARGEST

    def __init__(self, cell: KinematicCell, side: Side) -> None:
        self.cell, self.side = cell, side
        self.opening, self.goal, self.after = 0.01, 0.01, 0.01
        self.calibrated, self.calibrating = False, 0.0

    def step(self) -> None:
        if self.calibrating > 0.0:
            self.calibrating -= STEP
            if self.calibrating <= 0.0:
                self.calibrated, self.goal = True, self.after
        self.opening += float(np.clip(self.goal - self.opening, -PAD_SPEED * STEP, PAD_SPEED * STEP))

    def calibrate(self) -> None:
        self.calibrated, self.calibrating, self.goal, self.after = False, CALIBRATION_S, 0.0, LARGEST

    def command(self, opening: float, force: float) -> None:
        if not np.isfinite([opening, force]).all() or not (self.calibrated or self.calibrating > 0.0):
            raise DriverError(FailureKind.GRIPPER_FAULT, "not finite, or not calibrated")
        self.after = float(np.clip(opening, 0.0, LARGEST))
        self.goal = self.goal if self.calibrating > 0.0 else self.after

    def state(self) -> GripperState:
        moving = self.calibrating > 0.0 or abs(self.goal - self.opening) > 1e-4
        return GripperState(self.cell.t, self.side, self.opening, 0.0, moving, self.calibrated)

    def reading(self) -> TactileReading:
        """Noise, and the table under the tips, which are 0.1 mm deep per 0.4 N."""
        model, noise = self.cell.model, np.random.default_rng(round(1e3 * self.cell.t)).normal(0.0, 0.004, 26)
        tool = tool_pose(model.chains[self.side], self.cell.q[model.arm(self.side)])
        pressed = 4e3 * max(self.cell.table - tool[2, 3], 0.0)
        return TactileReading(
            self.cell.t, self.side, frozen(noise[:24].reshape(2, 4, 3)), frozen(pressed + noise[24:])
        )


@contextmanager
def kinematic_rig(
    settings: Any, camera: CameraCalibration, table: Table, broken: Callable[[KinematicCell], Ports]
) -> Iterator[Rig]:
    """A rig at a kinematic cell with an empty table. broken: makes its ports."""
    model = load_robot(settings)
    cell = KinematicCell(model, camera, lambda frame: _table_depth(camera, frame), table.height)

    def interrupt(seconds: float) -> None:
        cell.unheard_until = cell.t + seconds

    yield Rig(broken(cell), model, CollisionChecker(model, table), camera, table, 1.0, interrupt)


def _table_depth(camera: CameraCalibration, frame: CameraFrame) -> Array:
    """Depth (H, W) of an endless table."""
    k, T = frame.intrinsics, camera.T_table_camera
    v, u = np.mgrid[0 : k.height, 0 : k.width].astype(float)
    down = ((u - k.cx) / k.fx) * T[2, 0] + ((v - k.cy) / k.fy) * T[2, 1] + T[2, 2]
    return np.asarray(np.where(down < -0.1, -T[2, 3] / down, np.nan))
