"""Emulation of an arm that receives JointCommands: it checks the commands and their validity, and computes the
set-point that results from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.robots.baxter.emulator.initial_state import NEW, InitialState
from foldcell.robots.baxter.names import ARM_JOINTS, FULL_SPEED
from foldcell.robots.baxter.ros.messages import POSITION, RAW_POSITION
from foldcell.robots.ports import Array, Side

TICK = 0.01
"""Period of the emulated robot [s]."""
MAX_INTERVAL = 0.05
"""Largest interval between commands from which a velocity is computed [s]."""
MAX_DELAY = 2 * TICK
"""If the next command is later than this, the last command is no longer extrapolated [s]."""
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class _Command:
    """A JointCommand. at: time of arrival [s]; q: (7,) in the order of ARM_JOINTS [rad]; mode: POSITION or
    RAW_POSITION."""

    at: float
    q: Array
    mode: int


class Limb:
    """Command input of one arm. All times are the emulator's [s], which never go back. timeout: validity of a
    command; speed_ratio: fraction of full speed at which the joints move to a set-point in position mode."""

    def __init__(self, side: Side, past: InitialState = NEW) -> None:
        self.timeout, self.speed_ratio = past.timeout, past.speed_ratio
        self._names = [f"{side}_{joint}" for joint in ARM_JOINTS]
        self.forget()

    def forget(self) -> None:
        """Forget all commands. Needed after the motors were off."""
        self._heard = -math.inf
        self._held: Array | None = None
        self._newest: _Command | None = None
        self._before: _Command | None = None
        self._there: tuple[float, Array] | None = None
        """Time [s] and value of the last set-point."""

    def hear(self, mode: int, names: Sequence[str], values: Sequence[float], at: float, now: float) -> str | None:
        """Take a JointCommand that arrived at time `at`. Returns the reason if it is not executed, otherwise None.

        Joints that are not named stay at their last set-point. A command in an unsupported mode makes the arm
        hold. A malformed command changes nothing, and neither does a command that expired before it was read.
        """
        if not names or len(names) != len(values) or len({*names} & {*self._names}) != len(names):
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
        q = np.full(len(self._names), np.nan) if self._held is None else np.array(self._held, dtype=np.float64)
        q[[self._names.index(name) for name in names]] = values
        command = _Command(at, q, mode)
        if self._newest is not None and self._newest.at < at:
            self._before = self._newest
        self._newest, self._held = command, command.q
        return None

    def hear_timeout(self, seconds: float) -> str | None:
        """Set the timeout. Returns the reason if the message is not accepted, otherwise None."""
        if not (math.isfinite(seconds) and seconds > 0.0):
            return f"a command timeout of {seconds} s"
        self.timeout = seconds
        return None

    def hear_speed_ratio(self, ratio: float) -> str | None:
        """Set the speed ratio, clipped to 0 to 1. Returns the reason if the message is not accepted, otherwise
        None."""
        if math.isnan(ratio):
            return f"a speed ratio of {ratio}"
        self.speed_ratio = min(max(ratio, 0.0), 1.0)
        return None

    def fresh(self, now: float) -> bool:
        """Whether the last command is still valid."""
        return now - self._heard <= self.timeout + ROUNDING

    def set_point(self, now: float, standing: Array) -> tuple[Array, Array]:
        """Return position and velocity (7,), (7,) of the set-point [rad], [rad/s]. standing: (7,) measured
        position, used if there is no command.

        If the next command is late by one or two ticks, the last command is extrapolated with its velocity. After
        that the arm holds. In position mode the arm moves to the commanded position with at most the speed ratio,
        and stops when the command expires.
        """
        q, qd = self._wanted(now, standing)
        if self._newest is not None and self._newest.mode == POSITION:
            then, before = self._there or (now - TICK, np.array(standing))
            fastest = self.speed_ratio * FULL_SPEED if self.fresh(now) else np.zeros(7)
            reach = fastest * min(now - then, MAX_INTERVAL)
            q, qd = np.clip(q, before - reach, before + reach), np.clip(qd, -fastest, fastest)
        self._there = now, q
        return q, qd

    def _wanted(self, now: float, standing: Array) -> tuple[Array, Array]:
        """Return the commanded position and velocity (7,), (7,), without a speed limit."""
        if self._held is None:
            self._held = np.array(standing)
        elif np.isnan(self._held).any():  # joints without a set-point so far
            self._held = np.where(np.isnan(self._held), standing, self._held)
        late = now - self._heard - TICK
        if self._newest is None or late > MAX_DELAY + ROUNDING or not self.fresh(now):
            return self._held, np.zeros(7)
        qd = self._velocity()
        return self._held + max(late, 0.0) * qd, qd

    def _velocity(self) -> Array:
        """Return the velocity (7,) from the last two commands, clipped to the joints' limits [rad/s]."""
        if self._newest is None or self._before is None:
            return np.zeros(7)
        interval = max(self._newest.at - self._before.at, TICK)  # programs send no faster; networks may deliver so
        if interval > MAX_INTERVAL + ROUNDING:
            return np.zeros(7)
        turned = np.nan_to_num(self._newest.q - self._before.q)
        return np.clip(turned / interval, -FULL_SPEED, FULL_SPEED)
