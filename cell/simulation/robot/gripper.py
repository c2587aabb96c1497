"""The simulated electric gripper: the fingers close until the pads meet cloth or each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from foldcell.cell.simulation.noise import GripperNoise
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import GripperState, Side

_SNAPSHOT = ("opening", "pressing", "_goal", "_force", "_between", "_stroke", "_calibrated", "_t", "_step")
MOVING = 5e-4
"""The gripper reports that it moves while its opening differs from its goal by more than this [m]."""


class SimulatedGripper:
    """One gripper, whose pads open to `max_opening` [m]. Without cloth they meet at opening 0 and do not press.

    caught(stroke, force): called when the pads, closing from `stroke` [m], reach the opening at which they catch
    cloth. It returns the thickness between them [m], 0 for nothing. opened(): called when they release the cloth.
    """

    def __init__(
        self,
        side: Side,
        max_opening: float,
        noise: GripperNoise,
        seed: int,
        ideal: bool,
        caught: Callable[[float, float], float],
        opened: Callable[[], None],
    ) -> None:
        self.side, self.max_opening = side, max_opening
        self._noise, self._seed, self._ideal = noise, seed, ideal
        self._caught, self._opened = caught, opened
        self.opening = 0.0
        self.pressing = 0.0
        """Present force on each pad [N]."""
        self.stuck = False
        self.strength = 1.0
        """Share of the commanded force with which the gripper presses."""
        self.in_error = False
        self.broken = False
        """Whether a calibration does not help. While it is broken, the gripper reports an error."""
        self._goal, self._force = 0.0, 0.0
        self._between = 0.0
        self._stroke = 0.0
        self._calibrated = False
        self._calibrating: float | None = None
        self._after: tuple[float, float] | None = None
        self._t, self._step = 0.0, 0

    @property
    def holding(self) -> bool:
        """Whether something is between the pads and they press on it."""
        return self._between > 0.0

    @property
    def force(self) -> float:
        """Force with which the gripper presses when it meets something [N]."""
        return self._force * self.strength

    def lose_calibration(self) -> None:
        """Forget the calibration, as after a loss of power."""
        self._calibrated = False
        self._calibrating = self._after = None

    def calibrate(self) -> None:
        """Close and open once, which takes cell time, and clear an error unless the gripper is broken. Until the
        end it counts as not calibrated, also if it was. A command during the calibration is executed after it."""
        self.in_error = self.broken
        if self.in_error:
            return
        self._calibrating, self._calibrated = self._noise.calibration_time, False
        self._release()

    def command(self, opening: float, force: float) -> None:
        """Move to `opening` [m] with `force` [N]. Raises DriverError if not calibrated and for invalid values."""
        if not (np.isfinite(opening) and np.isfinite(force)):
            raise DriverError(
                FailureKind.GRIPPER_FAULT, f"the command is not finite: opening {opening} m, force {force} N"
            )
        if self.in_error:
            raise DriverError(
                FailureKind.GRIPPER_FAULT, f"the {self.side} gripper reports an error", "calibrate it again"
            )
        goal = float(np.clip(opening, 0.0, self.max_opening)), float(np.clip(force, 0.0, self._noise.max_force))
        if self._calibrating is not None:
            self._after = goal
            return
        if not self._calibrated:
            raise DriverError(
                FailureKind.GRIPPER_FAULT, f"the {self.side} gripper is not calibrated", "calibrate it first"
            )
        self._go(*goal)

    def _go(self, opening: float, force: float) -> None:
        closing = self._goal < self.opening - MOVING  # a command that is repeated on the way begins no new stroke
        if opening < self.opening and not closing:
            self._stroke = self.opening
        self._goal, self._force = opening, force

    def state(self) -> GripperState:
        opening, force = self.opening, self.pressing
        if not self._ideal:
            n = np.random.default_rng((self._seed, self._step)).standard_normal(2)
            opening = min(max(opening + self._noise.opening_noise * float(n[0]), 0.0), self.max_opening)
            force = max(0.0, force + self._noise.force_noise * float(n[1]))
        arrived = self.holding and self._goal <= self._between
        moving = self._calibrating is not None or (
            not self.stuck and not arrived and abs(self._goal - self.opening) > MOVING
        )
        return GripperState(self._t, self.side, opening, force, moving, self._calibrated, self.in_error)

    def snapshot(self) -> dict[str, float]:
        """The state, without a calibration in progress."""
        return {name: getattr(self, name) for name in _SNAPSHOT}

    def resume(self, saved: Mapping[str, float]) -> None:
        for name in _SNAPSHOT:
            setattr(self, name, saved[name])
        self._calibrated = bool(self._calibrated)
        self._calibrating = self._after = None

    def lost(self) -> None:
        """Note that the cloth has slipped out from between the pads. The pads continue to close."""
        self._between = 0.0

    def step(self, t: float, dt: float) -> None:
        self._t, self._step = t, self._step + 1
        self.in_error = self.in_error or self.broken
        if self._calibrating is not None:
            self._calibrate(dt)
        if not self.stuck:
            self._move(dt)
        pressing = self.force if self.holding and self._goal < self._between else 0.0
        self.pressing += (pressing - self.pressing) * min(1.0, dt / self._noise.force_time)

    def _calibrate(self, dt: float) -> None:
        assert self._calibrating is not None
        self._calibrating -= dt
        self._goal = 0.0 if self._calibrating > 0.5 * self._noise.calibration_time else self.max_opening
        if self._calibrating <= 0.0:
            self._calibrating, self._calibrated = None, True
            if self._after is not None:
                self._go(*self._after)
                self._after = None

    def _move(self, dt: float) -> None:
        before = self.opening
        stop = self._between if self.holding else 0.0
        step = self._noise.speed * dt
        self.opening += min(max(max(self._goal, stop) - before, -step), step)
        contact = self._noise.contact_opening
        if self._calibrating is None and before > contact >= self.opening:
            self._between = self._caught(self._stroke, self.force)  # a thicker stack pushes the pads open again
        elif self.holding and before < self.opening > self._between + MOVING:
            self._release()

    def _release(self) -> None:
        if self.holding:
            self._between = 0.0
            self._opened()
