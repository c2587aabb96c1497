"""What the arms are held to: the stop circuit, how old a state may be, and how far the arms may be off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.control.last_command import LastCommand
from cell.control.ticks import TICK_S
from robots.errors import Failure, FailureKind
from robots.ports import Array, JointSetpoint, JointState, Ports
from skills.vocabulary import Outcome

__all__ = ["ExecutionLimits", "come_to_rest", "followed", "fresh_state", "hold", "start_mismatch", "stopped"]


@dataclass(frozen=True)
class ExecutionLimits:
    """What a motion is held to.

    start [rad]: how far the arms may stand from a trajectory's first point; tracking [rad]: from the set-point
    while moving; settled [rad], settle_s: when a motion counts as arrived; stale_s: oldest joint state. altered
    [rad]: how much a driver may alter a set-point.
    """

    start: float = np.deg2rad(1.0)
    tracking: float = 0.12
    settled: float = 0.01
    settle_s: float = 1.0
    stale_s: float = 0.1
    altered: float = 0.002


def stopped(ports: Ports) -> Failure | None:
    """The stop circuit as a failure, or None."""
    stop = ports.stop.state()
    if not stop.stopped:
        return None
    return Failure(
        FailureKind.STOPPED,
        f"the stop was triggered: {stop.reason or 'no reason given'}",
        "clear the cause and reset the stop before anything is begun again",
    )


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


def followed(ports: Ports, q: Array, sent: JointSetpoint, limits: ExecutionLimits) -> Outcome[JointState]:
    """The arms' state a tick after the set-point q (14,), of which the driver sent `sent`.

    Failures: STOPPED, STALE_STATE; LIMIT_EXCEEDED (an altered set-point) and TRACKING_ERROR, upon which the arms
    are told to hold where they are.
    """
    halted = stopped(ports)
    if halted:
        return Outcome(failure=halted)
    read = fresh_state(ports, limits)
    if read.failure:
        return read
    astray = _altered(sent, q, limits) or _straying(read.unwrap(), q, limits)
    if astray:
        hold(ports, limits)
        return Outcome(failure=astray)
    return read


def hold(ports: Ports, limits: ExecutionLimits) -> None:
    """Command the arms to stand where they are.

    Arms of which nothing recent is known are told nothing: where they last were may be far from where they are,
    and a driver that hears nothing for its command timeout holds them.
    """
    read = fresh_state(ports, limits)
    if read.ok:
        q = read.unwrap().q
        ports.arms.command(q, np.zeros_like(q))


def come_to_rest(ports: Ports, limits: ExecutionLimits, last_command: LastCommand) -> Failure | None:
    """Let arms that are off their last set-point come back to it before anything is planned from where they stand:
    a sudden drop takes a moment. Those that do not within settle_s are left to the checks of the next motion."""
    deadline = ports.clock.now() + limits.settle_s
    while last_command.q is not None and ports.clock.now() < deadline:
        read = fresh_state(ports, limits)
        failure = stopped(ports) or read.failure
        if failure or np.abs(read.unwrap().q - last_command.q).max() <= limits.settled:
            return failure
        ports.clock.sleep_until(ports.clock.now() + TICK_S)
    return None


def start_mismatch(state: JointState, q0: Array, limits: ExecutionLimits) -> Failure | None:
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


def _altered(sent: JointSetpoint, q: Array, limits: ExecutionLimits) -> Failure | None:
    """A driver that sends something else than it was told leads the arms off the path."""
    off = np.abs(sent.q - q)
    joint = int(off.argmax())
    if off[joint] <= limits.altered:
        return None
    return Failure(
        FailureKind.LIMIT_EXCEEDED,
        f"the driver moved joint {joint}'s set-point by {np.rad2deg(off[joint]):.2f} degrees",
        "compare the robot's own limits with the model's",
        {
            "joint": joint,
            "off_rad": float(off[joint]),
            "limit_rad": limits.altered,
            "clipped": sent.clipped,
        },
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
