"""A strict fake of a cell's ports. It executes each command immediately and raises an error on commands that no
cell may get.

Time passes only in `sleep_until`. `at` schedules a call at a moment of cell time.
"""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import (
    Array,
    BoardPlace,
    CameraFrame,
    GripperState,
    Intrinsics,
    JointSetpoint,
    JointState,
    Ports,
    Side,
    StopState,
    TactileReading,
)

RATE_LIMIT = 1.6  # [rad/s]: above the velocity limit of any Baxter shoulder joint


def live_noise(now: float) -> float:
    """A noise of 1 mN [N] that differs from tick to tick: the readings of a live pad are never constant."""
    return 1e-3 * float(np.cos(1e3 * now))


class FakeCell:
    """The state behind the fake ports."""

    def __init__(self, q: Array | None = None) -> None:
        self.now = 0.0
        self.q = np.zeros(14) if q is None else np.array(q)
        self.frozen_since: float | None = None
        self.stop_reason = ""
        self.commands: list[tuple[float, Array]] = []
        self.openings = {s: 0.04 for s in Side}
        self.pads = {s: 0.0 for s in Side}  # force on each pad of a hand [N]
        self.follows = True
        self.same_positions = True
        """Whether the joint state repeats the positions of resting arms exactly. Encoders have noise."""
        self.pictures = 0
        self._due: list[tuple[float, Callable[[], None]]] = []

    def at(self, t: float, happen: Callable[[], None]) -> None:
        self._due.append((t, happen))

    def ports(self) -> Ports:
        return Ports(
            driver="fake", simulated=True, clock=_Clock(self), arms=_Arms(self), head=_Head(),
            grippers=MappingProxyType({s: _Gripper(self, s) for s in Side}),
            tactile=MappingProxyType({s: _Tactile(self, s) for s in Side}),
            camera=_Camera(self), stop=_Stop(self), attendant=_Attendant(),
        )  # fmt: skip


class _Clock:
    def __init__(self, cell: FakeCell) -> None:
        self._cell = cell

    def now(self) -> float:
        return self._cell.now

    def sleep_until(self, t: float) -> None:
        self._cell.now = max(t, self._cell.now)
        due = [d for d in self._cell._due if d[0] <= self._cell.now]
        self._cell._due = [d for d in self._cell._due if d[0] > self._cell.now]
        for _, happen in due:
            happen()


class _Arms:
    command_timeout = 0.2

    def __init__(self, cell: FakeCell) -> None:
        self._cell = cell

    def state(self) -> JointState:
        c = self._cell
        stamp = c.now if c.frozen_since is None else c.frozen_since
        noise = 0.0 if c.same_positions else 1e-6 * live_noise(stamp)
        return JointState(stamp, c.q + noise, np.zeros(14), np.zeros(14), 0.0)

    def enable(self) -> None:
        if self._cell.stop_reason:
            raise DriverError(FailureKind.STOPPED, "enabled while stopped")

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        c = self._cell
        if c.stop_reason:
            raise AssertionError("a set-point was sent to a stopped robot")
        if not (np.all(np.isfinite(q)) and np.all(np.isfinite(qd))):
            raise AssertionError("a set-point that is not a number")
        if c.commands:
            t, last = c.commands[-1]
            jump = min(
                np.abs(q - last).max(), np.abs(q - c.q).max()
            )  # a set-point at the arms' present position is no jump
            if c.now > t and jump > RATE_LIMIT * (c.now - t) + 0.03:
                raise AssertionError("a set-point that jumps")
        c.commands.append((c.now, q.copy()))
        if c.follows:
            c.q = q.copy()
        return JointSetpoint(c.now, q, qd, False)


class _Head:
    def command_pan(self, angle: float) -> None: ...


class _Gripper:
    max_opening = 0.0416

    def __init__(self, cell: FakeCell, side: Side) -> None:
        self._cell, self.side = cell, side

    def calibrate(self) -> None: ...

    def command(self, opening: float, force: float) -> None:
        self._cell.openings[self.side] = opening

    def state(self) -> GripperState:
        return GripperState(self._cell.now, self.side, self._cell.openings[self.side], 0.0, False, True)


class _Tactile:
    def __init__(self, cell: FakeCell, side: Side) -> None:
        self._cell, self.side = cell, side

    def reading(self) -> TactileReading:
        noise = live_noise(self._cell.now)
        cells = np.full((2, 4, 3), self._cell.pads[self.side] / 12 + noise)
        return TactileReading(self._cell.now, self.side, cells, np.full(2, noise))


class _Camera:
    def __init__(self, cell: FakeCell) -> None:
        self._cell = cell

    def capture(self) -> CameraFrame:
        k = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)
        rgb = np.full((480, 640, 3), 128, np.uint8)
        self._cell.pictures += 1  # no two pictures of a live camera are equal
        rgb[0, 0], rgb[0, 1] = divmod(self._cell.pictures, 256)
        depth = np.ones((480, 640), np.float32)
        depth[0, 0] += self._cell.pictures * 1e-4
        return CameraFrame(self._cell.now, 0, rgb, depth, k)

    def glimpse(self) -> CameraFrame:
        return self.capture()


class _Stop:
    def __init__(self, cell: FakeCell) -> None:
        self._cell = cell

    def trigger(self, reason: str) -> None:
        self._cell.stop_reason = reason

    def state(self) -> StopState:
        return StopState(self._cell.now, bool(self._cell.stop_reason), self._cell.stop_reason)

    def reset(self) -> None:
        self._cell.stop_reason = ""


class _Attendant:
    def lay_garment(self) -> None: ...

    def bring_board(self, place: BoardPlace) -> None: ...
