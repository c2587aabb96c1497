"""The driver under test with its robot's model, and the small checked moves of the clauses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from foldcell.cell.control.checks import ExecutionLimits, followed
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motion import Watch
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.rest import await_rest
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, JointState, Ports
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.trajectory_check import check_trajectory
from foldcell.skills.vocabulary import CameraCalibration, Table

REASON = "the check of the driver tests the stop"
"""Reason of the stops that a check triggers. It resets no other stop."""
LIMITS = ExecutionLimits(start=float(np.deg2rad(1.0)), tracking=0.12, stale_s=0.1)


class BrokenError(Exception):
    """The driver breaks a clause. The text says how."""


class UnprovenError(Exception):
    """A clause cannot be tried here. The text says why."""


def require(holds: object, otherwise: str) -> None:
    """Raise BrokenError unless the condition holds."""
    if not holds:
        raise BrokenError(otherwise)


@dataclass(frozen=True, eq=False)
class Rig:
    """The driver under test. checker: of the moves. calibration, table: what the camera should see. head_range:
    largest angle of the head to either side, 0 for a fixed head [rad]. interrupt: lets no joint state arrive for
    some time [s]; None: nothing can do this at this driver. ended: whether a signal asks for the end."""

    ports: Ports
    model: RobotModel
    checker: CollisionChecker
    calibration: CameraCalibration
    table: Table
    head_range: float
    interrupt: Callable[[float], None] | None = None
    ended: Callable[[], bool] = lambda: False

    @property
    def state(self) -> JointState:
        return self.ports.arms.state()

    @property
    def now(self) -> float:
        return self.ports.clock.now()

    def wait(self, seconds: float) -> None:
        """Let cell time pass, one tick after the other."""
        for _ in self.ticks(seconds):
            pass

    def ticks(self, seconds: float) -> Iterator[float]:
        """Yield the time after each tick, for `seconds`. A clock that stands still does not prolong this."""
        for _ in range(round(seconds / TICK_S)):
            self.ports.clock.sleep_until(self.now + TICK_S)
            yield self.now

    def within(self, seconds: float, condition: Callable[[], bool]) -> bool:
        """Whether the condition holds now or after one of the next ticks."""
        return condition() or any(condition() for _ in self.ticks(seconds))

    def ready(self) -> None:
        """Bring the arms to rest with their motors on. Raises UnprovenError for a stop that the check has not
        triggered, which only a person may reset, and for arms that do not rest."""
        stop = self.ports.stop.state()
        if stop.stopped:
            if REASON not in stop.reason:
                raise UnprovenError(f"the robot is stopped: {stop.reason}")
            if self.ended():
                raise UnprovenError("the check was interrupted")
            self.ports.stop.reset()
        self.ports.arms.enable()
        unrest = await_rest(self.ports, LIMITS)
        if unrest is not None:
            raise UnprovenError(f"the arms do not rest: {unrest.what}")

    def refused(self, call: Callable[[], object], what: str, *kinds: FailureKind) -> None:
        """Require that the call raises DriverError, of one of the kinds if any are named."""
        try:
            call()
        except DriverError as error:
            require(not kinds or error.kind in kinds, f"{what} is refused as {error.kind}, not as {kinds[0:1]}")
        else:
            raise BrokenError(f"{what} is accepted")

    def hold_command(self) -> None:
        """Command the arms to stay where they are."""
        q = self.state.q
        self.ports.arms.command(q, np.zeros_like(q))

    def plan(self, offset: Array) -> ArmTrajectory:
        """Return the slow motion that adds `offset` (joints,) to the joints, or subtracts those of its entries
        that only go the other way. It is planned and checked like every motion of a run."""
        q, limits = self.state.q, self.model.commissioning
        why = ""
        for sign in (1.0, -1.0):
            rng = np.random.default_rng(0)
            planned = plan_free_motion(self.model, self.checker, q, q + sign * offset, limits=limits, rng=rng)
            checked = (
                planned.failure
                or check_trajectory(
                    self.model, self.checker, planned.unwrap(), q, limits, start_tolerance=LIMITS.start
                ).failure
            )
            if checked is None:
                return planned.unwrap()
            why = checked.what
        raise UnprovenError(f"no small free motion from here: {why}")

    def move(self, offset: Array, watch: Watch | None = None) -> None:
        """Perform the motion of `plan` with all checks of the control loop. watch: called on every tick."""
        loop = ControlLoop(self.ports, LIMITS, LastCommand())
        control = PathControl(None, self.model.protective, self.model.commissioning)
        failure = stream(loop, self.plan(offset), watch, control).failure
        require(failure is None, f"a small motion fails: {failure and failure.what}")

    def drive(self, trajectory: ArmTrajectory, share: float) -> tuple[Array, Array]:
        """Send only the first `share` of a trajectory, each set-point checked. Returns the last set-point q, qd
        (joints,), with the arms in motion."""
        for k in range(max(1, round(share * trajectory.duration / TICK_S))):
            q, qd = trajectory.at(k * TICK_S)
            sent = self.ports.arms.command(q, qd)
            self.ports.clock.sleep_until(self.now + TICK_S)
            failure = followed(self.ports, q, sent, LIMITS).failure
            require(failure is None, f"a small motion fails: {failure and failure.what}")
        return q, qd

    def wrists(self, angle: float) -> Array:
        """Return an offset (joints,) that turns the last joint of both arms, which only turns the hands."""
        offset = np.zeros(len(self.model.q_park))
        offset[[len(offset) // 2 - 1, -1]] = angle
        return offset
