"""The simulated arms: the robot's controller, its tracking errors and its sensors, on top of the PyBullet body.

Set-points arrive with a lag and are extrapolated by their velocity between commands. If no command arrives within
the command timeout, the arms hold. Jitter and sudden drops move an arm off its set-point, and encoder bias shifts
its true position from the measured one. A stop brakes both arms with a bounded deceleration.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foldcell.cell.simulation.noise import RobotNoise
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Array, JointSetpoint, JointState, Side, StopState, arm_slice, frozen
from foldcell.robots.robot import SimulatedBody, Simulation
from foldcell.robots.setpoint import clip_setpoint

EXTRAPOLATION = 0.02
"""Longest time for which a set-point is extrapolated [s]."""
MOVING = 0.05
"""At this joint speed and above, jitter has its full size [rad/s]. Sudden drops happen only to an arm with a joint
that moves faster than this."""
HEAD_SPEED = 0.6  # [rad/s]
CIRCUIT = "the stop circuit is open"


@dataclass(frozen=True)
class _Drop:
    """An active sudden drop: largest angle [rad] of the joint that gives way, start and duration [s]."""

    start: float
    duration: float
    angle: float

    def offset(self, t: float) -> float:
        s = (t - self.start) / self.duration
        return self.angle * float(np.sin(np.pi * s) ** 2) if 0.0 < s < 1.0 else 0.0


class SimulatedRobot:
    """Both arms and the head. `step` advances the controller by one physics step."""

    def __init__(
        self,
        body: SimulatedBody,
        design: Simulation,
        model: RobotModel,
        noise: RobotNoise,
        rng: np.random.Generator,
        q_start: Array,
        ideal: bool,
    ) -> None:
        self._body, self._noise, self._rng, self._ideal = body, noise, rng, ideal
        self._design, self._joints = design, len(q_start)
        self._limits = model.protective
        self._brake = noise.brake * (self._limits.acceleration / self._limits.acceleration.min())
        scale = 0.0 if ideal else 1.0
        self._bias = scale * noise.encoder_bias * rng.standard_normal(self._joints)
        self._lag = 0.0 if ideal else noise.lag.draw(rng)
        self._reading = int(rng.integers(2**31))
        self._jitter = np.zeros(self._joints)
        self._effort = np.zeros(self._joints)
        self._drops: dict[Side, _Drop] = {}
        self._hung: dict[Side, Array] = {}
        """Positions of the motors of an arm that hangs, or that returns to its set-point after it hung [rad]."""
        self._hanging: set[Side] = set()
        self._circuit_open = False
        self._enabled = False
        self._stop_reason: str | None = None
        self._stop_stamp = 0.0
        self._queue: deque[JointSetpoint] = deque()
        """Set-points on their way, stamped with the time of their arrival."""
        self._active: JointSetpoint | None = None
        self._sent = q_start.copy()
        self._target, self._velocity = q_start.copy(), np.zeros(self._joints)
        self._head_goal = self._head = 0.0
        self._step = 0
        self._t = 0.0
        self._read: tuple[int, JointState] | None = None
        """The last reading, and the physics step after which it was taken."""
        body.place(q_start - self._bias, 0.0, dict.fromkeys(Side, 0.0))

    # called by the ports

    def enable(self) -> None:
        reason = self._stopped_by()
        if reason is not None:
            raise DriverError(
                FailureKind.STOPPED,
                f"the arms cannot be enabled: stopped ({reason})",
                "reset the stop first",
            )
        self._enabled = True

    def command(self, q: Array, qd: Array, delivered: bool = True) -> JointSetpoint:
        """Accept a set-point (n,) [rad], (n,) [rad/s] and return the clipped set-point. delivered: whether it
        reaches the robot. Raises DriverError if the arms are stopped or not enabled, or for invalid vectors."""
        q, qd = np.asarray(q, dtype=np.float64), np.asarray(qd, dtype=np.float64)
        shape = (self._joints,)
        if q.shape != shape or qd.shape != shape or not (np.isfinite(q).all() and np.isfinite(qd).all()):
            raise DriverError(
                FailureKind.HARDWARE_FAULT,
                f"not two finite vectors of {self._joints}: shapes {q.shape}, {qd.shape}",
            )
        reason = self._stopped_by()
        if reason is not None:
            raise DriverError(FailureKind.STOPPED, f"stopped: {reason}", "reset the stop, then enable the arms")
        if not self._enabled:
            raise DriverError(FailureKind.HARDWARE_FAULT, "the arms are not enabled", "enable them first")
        last_command = clip_setpoint(q, qd, self._sent, self.state().q, self._limits, self._t)
        if delivered:
            self._queue.append(replace(last_command, stamp=self._t + self._lag))
        self._sent = last_command.q
        return last_command

    def state(self) -> JointState:
        """Return the measured state. Its noise depends only on the physics step, so that the number of readings
        changes no other random number."""
        if self._read is None or self._read[0] != self._step:
            self._read = self._step, self._measured()
        return self._read[1]

    def _measured(self) -> JointState:
        q, qd, _, pan = self._body.read()
        q, qd, effort = q + self._bias, qd.copy(), self._effort.copy()
        if not self._ideal:
            n = np.random.default_rng((self._reading, self._step)).standard_normal((3, self._joints))
            q += self._noise.encoder_noise * n[0]
            qd += self._noise.velocity_noise * n[1]
            effort = effort + self._noise.effort_noise * n[2]
        return JointState(self._t, frozen(q), frozen(qd), frozen(effort), pan)

    def command_pan(self, angle: float) -> None:
        if not math.isfinite(angle):
            raise DriverError(FailureKind.HARDWARE_FAULT, f"invalid angle for the head: {angle}")
        self._head_goal = float(np.clip(angle, -self._design.head_range, self._design.head_range))

    def trigger_stop(self, reason: str) -> None:
        """Set the stop, which the next physics step reads. Safe from any thread and from a signal handler."""
        if self._stop_reason is None:
            self._stop_stamp = self._t
            self._stop_reason = reason or "no reason given"

    def stop_state(self) -> StopState:
        reason = self._stopped_by()
        return StopState(self._t if reason is None else self._stop_stamp, reason is not None, reason or "")

    def reset_stop(self) -> None:
        self._stop_reason = None
        self._enabled = False

    def _stopped_by(self) -> str | None:
        """Return the reason of the stop, None if nothing stops the arms."""
        return self._stop_reason or (CIRCUIT if self._circuit_open else None)

    def snapshot(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return the state for a later `resume`: arrays, and plain values including the random generator's
        state."""
        q, _, _, pan = self._body.read()
        arrays = {"q": q, "target": self._target, "jitter": self._jitter}
        plain = {"pan": pan, "head": self._head, "goal": self._head_goal, "step": self._step, "t": self._t}
        return arrays, {**plain, "rng": self._rng.bit_generator.state}

    def resume(self, arrays: Mapping[str, Array], plain: Mapping[str, Any], opening: Mapping[Side, float]) -> None:
        """Restore a snapshot: arms at rest, motors off, no stop. opening: of each gripper [m]."""
        self._target, self._jitter = arrays["target"].copy(), arrays["jitter"].copy()
        self._sent, self._velocity = self._target.copy(), np.zeros(self._joints)
        self._head, self._head_goal = plain["head"], plain["goal"]
        self._step, self._t = plain["step"], plain["t"]
        self._rng.bit_generator.state = plain["rng"]
        self._queue.clear()
        self._active, self._enabled, self._stop_reason = None, False, None
        self._drops.clear()
        self._hung.clear()
        self._hanging.clear()
        self._circuit_open = False
        self._read = None
        self._body.place(arrays["q"], plain["pan"], opening)

    # called by the world

    def step(self, t: float, dt: float, opening: Mapping[Side, float]) -> None:
        """Set the motor targets for the physics step that ends at time t [s]. The caller performs the step."""
        self._t, self._step = t, self._step + 1
        follow = 1.0 - np.exp(-dt / self._noise.effort_time)
        self._effort += follow * (self._body.read()[2] - self._effort)
        if self._stopped_by() is not None:
            self._enabled = False
            self._queue.clear()
            self._active = None
        while self._queue and self._queue[0].stamp <= t:
            self._active = self._queue.popleft()
        if self._active is not None and t - self._active.stamp > self._noise.command_timeout:
            self._active = None
        if self._active is None:
            self._hold(dt)
        else:
            late = min(t - self._active.stamp, EXTRAPOLATION)
            self._target = self._within(self._active.q + late * self._active.qd)
            self._velocity = self._active.qd
        turn = HEAD_SPEED * dt
        self._head += min(max(self._head_goal - self._head, -turn), turn)
        goal, velocity = self._target - self._bias + self._disturbance(t, dt), self._velocity
        if self._hung:
            goal, velocity = self._held_back(goal, velocity, dt)
        self._body.drive(goal, velocity, self._head, opening)

    def _within(self, q: Array) -> Array:
        return np.asarray(np.minimum(np.maximum(q, self._limits.lower), self._limits.upper))

    def _hold(self, dt: float) -> None:
        """Brake to rest and hold."""
        v = self._velocity
        self._velocity = np.sign(v) * np.maximum(np.abs(v) - self._brake * dt, 0.0)
        self._target = self._within(self._target + 0.5 * (v + self._velocity) * dt)
        self._sent = self._target

    def _disturbance(self, t: float, dt: float) -> Array:
        """Return the offset (n,) from the set-point [rad]: jitter (Ornstein-Uhlenbeck process) and drops."""
        speed = np.abs(self._velocity)
        if self._ideal:
            offset = np.zeros(self._joints)
        else:
            keep = math.exp(-dt / self._noise.jitter_time)
            kick = self._noise.jitter * math.sqrt(1.0 - keep**2)
            self._jitter = keep * self._jitter + kick * self._rng.standard_normal(self._joints)
            offset = self._jitter * np.minimum(speed / MOVING, 1.0)
            for side, p in zip(Side, self._rng.random(2), strict=True):
                if (
                    p < self._noise.drops_per_minute / 60.0 * dt
                    and speed[arm_slice(side, self._joints)].max() > MOVING
                ):
                    self.drop(side, self._noise.drop_depth.draw(self._rng), self._noise.drop_time.draw(self._rng))
        for side, drop in list(self._drops.items()):
            offset[arm_slice(side, self._joints)][self._design.drop_joint] += self._design.drop_sign[
                side
            ] * drop.offset(t)
            if t > drop.start + drop.duration:
                del self._drops[side]
        return offset

    def _held_back(self, goal: Array, velocity: Array, dt: float) -> tuple[Array, Array]:
        """Return motor positions and velocities (n,), (n,). The motors of an arm that hangs stand still. After it
        hung, an arm returns to its goal at its full speed."""
        goal, velocity = goal.copy(), velocity.copy()
        for side, place in list(self._hung.items()):
            cut = arm_slice(side, self._joints)
            if side not in self._hanging:
                reach = self._limits.velocity[cut] * dt
                step = np.clip(goal[cut] - place, -reach, reach)
                if np.array_equal(step, goal[cut] - place):
                    del self._hung[side]
                    continue
                place = self._hung[side] = place + step
            goal[cut], velocity[cut] = place, 0.0
        return goal, velocity

    def hang(self, side: Side, hangs: bool) -> None:
        """Let the motors of an arm stand still from now on, or let them go."""
        if hangs and side not in self._hanging:
            self._hung.setdefault(side, self._body.read()[0][arm_slice(side, self._joints)].copy())
            self._hanging.add(side)
        elif not hangs:
            self._hanging.discard(side)

    def open_circuit(self, opened: bool) -> None:
        """Open the stop circuit, which stops the arms like `trigger_stop`, or close it. Closing it switches no
        motor on."""
        if opened and self._stopped_by() is None:
            self._stop_stamp = self._t
        self._circuit_open = opened

    def drop(self, side: Side, depth: float, duration: float) -> None:
        """Begin a drop of an arm by `depth` [m] at the tool, which ends after `duration` [s]."""
        position, _ = self._body.tool_pose(side)
        shoulder = np.array(self._design.shoulder[side])
        reach = max(float(np.linalg.norm(position[:2] - shoulder)), 0.3)
        self._drops[side] = _Drop(self._t, duration, depth / reach)
