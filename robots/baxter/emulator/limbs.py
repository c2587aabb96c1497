"""How an arm takes JointCommands: which it obeys, for how long, and what set-point it follows meanwhile."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robots.baxter.emulator.initial_state import NEW, InitialState
from robots.baxter.model import ARM_JOINTS, URDF_VELOCITY
from robots.baxter.ros.joint_modes import POSITION, RAW_POSITION
from robots.ports import Array, Side, arm_slice

__all__ = ["TICK", "Limb"]

TICK = 0.01
"""Of the emulated robot [s]."""
APART = 0.05
"""Set-points further apart than this are no motion with a velocity [s]."""
LATE = 2 * TICK
"""A command that was due so long ago is followed no further [s]."""
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class _Command:
    """at: when it was heard [s]; q: (7,) [rad] in our order; mode: POSITION or RAW_POSITION."""

    at: float
    q: Array
    mode: int


class Limb:
    """One arm's intake. All times are cell time [s]. timeout: for so long a command holds; speed_ratio: the share
    of their speed with which the joints go to a set-point in position mode."""

    def __init__(self, side: Side, past: InitialState = NEW) -> None:
        self.timeout, self.speed_ratio = past.timeout, past.speed_ratio
        self._names = [f"{side}_{joint}" for joint in ARM_JOINTS]
        self._fastest = URDF_VELOCITY[arm_slice(side)]
        self.forget()

    def forget(self) -> None:
        """No command is under way and none is remembered: the motors were off."""
        self._heard = -math.inf
        self._held: Array | None = None
        self._newest: _Command | None = None
        self._before: _Command | None = None
        self._there: tuple[float, Array] | None = None
        """When it was last asked for a set-point [s], and what that was."""

    def hear(self, mode: int, names: Sequence[str], values: Sequence[float], at: float, now: float) -> str | None:
        """Take a JointCommand that came at time `at`; -> why it is not obeyed, None if it is.

        One in a mode that this robot has not makes the arm hold; a malformed one changes nothing, nor does one
        that has run out before it was read.
        """
        if len(names) != len(values) or sorted(names) != sorted(self._names):
            return f"a command of {len(values)} values for {', '.join(names) or 'no joints'}"
        if not all(math.isfinite(value) for value in values):
            return "a command that is not a number"
        if now - at > self.timeout + ROUNDING:
            return None
        self._heard = at
        if mode not in (POSITION, RAW_POSITION):
            self._newest = self._before = None
            self._held = self._there[1] if self._there is not None else self._held
            return f"mode {mode}: it holds (modes {POSITION} and {RAW_POSITION} are emulated)"
        by_name = dict(zip(names, values, strict=True))
        command = _Command(at, np.array([by_name[name] for name in self._names], dtype=np.float64), mode)
        if self._newest is not None and self._newest.at < at:
            self._before = self._newest
        self._newest, self._held = command, command.q
        return None

    def hear_timeout(self, seconds: float) -> str | None:
        """-> why it is not obeyed, None if it is."""
        if not (math.isfinite(seconds) and seconds > 0.0):
            return f"a command timeout of {seconds} s"
        self.timeout = seconds
        return None

    def hear_speed_ratio(self, ratio: float) -> str | None:
        """-> why it is not obeyed, None if it is."""
        if not 0.0 < ratio <= 1.0:
            return f"a speed ratio of {ratio}"
        self.speed_ratio = ratio
        return None

    def fresh(self, now: float) -> bool:
        """Whether a command holds."""
        return now - self._heard <= self.timeout + ROUNDING

    def set_point(self, now: float, standing: Array) -> tuple[Array, Array]:
        """(7,), (7,) where the arm is to be and how fast; standing: (7,) where it is, for want of a command.

        A command that is late by a tick or two is carried on by its velocity; after that it is held. In position
        mode the arm is on its way to it, no faster than it was told, and stays when the command has run out.
        """
        q, qd = self._wanted(now, standing)
        if self._newest is not None and self._newest.mode == POSITION:
            then, before = self._there or (now - TICK, np.array(standing))
            fastest = self.speed_ratio * self._fastest if self.fresh(now) else np.zeros(7)
            reach = fastest * min(now - then, APART)
            q, qd = np.clip(q, before - reach, before + reach), np.clip(qd, -fastest, fastest)
        self._there = now, q
        return q, qd

    def _wanted(self, now: float, standing: Array) -> tuple[Array, Array]:
        """(7,), (7,) as it was told, whatever its speed."""
        if self._held is None:
            self._held = np.array(standing)
        late = now - self._heard - TICK
        if self._newest is None or late > LATE + ROUNDING or not self.fresh(now):
            return self._held, np.zeros(7)
        qd = self._velocity()
        return self._held + max(late, 0.0) * qd, qd

    def _velocity(self) -> Array:
        """(7,) [rad/s] by the last two commands, never more than the joints can."""
        if self._newest is None or self._before is None:
            return np.zeros(7)
        apart = self._newest.at - self._before.at
        if apart > APART + ROUNDING:
            return np.zeros(7)
        return np.clip((self._newest.q - self._before.q) / apart, -self._fastest, self._fastest)
