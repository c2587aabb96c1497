"""Streaming a checked trajectory to the arms at 100 Hz, and watching that they follow.

The one place where set-points leave the executive. Every tick reads the arms back: stopped, stale or
straying arms end the motion with a typed failure, and so does whatever a caller watches for (a slipping
garment). After a failure the arms are told to hold where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robots.errors import Failure, FailureKind
from robots.ports import ArmTrajectory, Array, JointState, Ports
from skills.vocabulary import Outcome

__all__ = ["ExecutionLimits", "Tick", "Watch", "fresh_state", "hold", "stream", "wait"]

TICK_S = 0.01


@dataclass(frozen=True)
class ExecutionLimits:
    """What a motion is held to.

    start [rad]: how far the arms may stand from a trajectory's first point; tracking [rad]: from the set-point
    while moving; settled [rad], settle_s: when a motion counts as arrived; stale_s: oldest joint state.
    """

    start: float = np.deg2rad(1.0)
    tracking: float = 0.12
    settled: float = 0.01
    settle_s: float = 1.0
    stale_s: float = 0.1


@dataclass(frozen=True, eq=False)
class Tick:
    """What a watcher sees: time since the motion began [s] and the arms as read back."""

    t: float
    state: JointState


Watch = Callable[[Tick], Failure | None]


def stopped(ports: Ports) -> Failure | None:
    """The stop circuit as a failure, or None."""
    stop = ports.stop.state()
    if not stop.stopped:
        return None
    return Failure(FailureKind.STOPPED, f"the stop was triggered: {stop.reason or 'no reason given'}",
                   "clear the cause, reset the stop, start a new run")  # fmt: skip


def fresh_state(ports: Ports, limits: ExecutionLimits) -> Outcome[JointState]:
    """The arms' state if it is recent enough to act on, else STALE_STATE."""
    state = ports.arms.state()
    age = ports.clock.now() - state.stamp
    if age > limits.stale_s or not np.all(np.isfinite(state.q)):
        return Outcome(
            failure=Failure(
                FailureKind.STALE_STATE,
                f"the arms' state is {age * 1e3:.0f} ms old",
                "check the connection to the robot",
                {"age_s": age, "limit_s": limits.stale_s},
            )
        )
    return Outcome(state)


def hold(ports: Ports) -> None:
    """Command the arms to stand where they are."""
    q = ports.arms.state().q
    ports.arms.command(q, np.zeros_like(q))


def wait(ports: Ports, seconds: float, watch: Watch | None = None) -> Failure | None:
    """Hold the present set-point for some cell time, watching. Ends early on a failure."""
    q = ports.arms.state().q
    t0 = ports.clock.now()
    for k in range(max(1, round(seconds / TICK_S))):
        ports.arms.command(q, np.zeros_like(q))
        ports.clock.sleep_until(t0 + (k + 1) * TICK_S)
        failure = stopped(ports) or (watch(Tick((k + 1) * TICK_S, ports.arms.state())) if watch else None)
        if failure:
            return failure
    return None


def stream(
    ports: Ports, trajectory: ArmTrajectory, limits: ExecutionLimits, watch: Watch | None = None
) -> Outcome[JointState]:
    """Send the trajectory and see it through. Returns the state in which the arms came to rest.

    Failures: STOPPED, STALE_STATE, START_MISMATCH, TRACKING_ERROR, or what `watch` returned.
    """
    start = fresh_state(ports, limits)
    failure = stopped(ports) or start.failure or _start_mismatch(start.unwrap(), trajectory.q[0], limits)
    if failure:
        return Outcome(failure=failure)
    t0 = ports.clock.now()
    arrived = trajectory.duration + limits.settle_s
    k = 0
    while True:
        q, qd = trajectory.at(k * TICK_S)
        last = k * TICK_S >= trajectory.duration
        ports.arms.command(q, qd)
        k += 1
        ports.clock.sleep_until(t0 + k * TICK_S)
        read = fresh_state(ports, limits)
        failure = stopped(ports) or read.failure
        if not failure:
            state = read.unwrap()
            failure = _straying(state, q, limits) or (watch(Tick(k * TICK_S, state)) if watch else None)
        if failure:
            if failure.kind is not FailureKind.STOPPED:
                hold(ports)
            return Outcome(failure=failure)
        if last and (k * TICK_S >= arrived or float(np.abs(state.q - trajectory.q[-1]).max()) < limits.settled):
            return Outcome(state, notes={"motion_s": k * TICK_S})


def _start_mismatch(state: JointState, q0: Array, limits: ExecutionLimits) -> Failure | None:
    off = np.abs(state.q - q0)
    joint = int(off.argmax())
    if off[joint] <= limits.start:
        return None
    return Failure(
        FailureKind.START_MISMATCH,
        f"joint {joint} stands {np.rad2deg(off[joint]):.1f} degrees from where the trajectory starts",
        "plan again from where the arms are",
        {"joint": joint, "off_rad": float(off[joint]), "limit_rad": limits.start},
    )


def _straying(state: JointState, q: Array, limits: ExecutionLimits) -> Failure | None:
    off = np.abs(state.q - q)
    joint = int(off.argmax())
    if off[joint] <= limits.tracking:
        return None
    return Failure(
        FailureKind.TRACKING_ERROR,
        f"joint {joint} is {np.rad2deg(off[joint]):.1f} degrees off its set-point",
        "look for an obstacle or a weak motor before going on",
        {"joint": joint, "off_rad": float(off[joint]), "limit_rad": limits.tracking},
    )
