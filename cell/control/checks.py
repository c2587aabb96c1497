"""Checks of the arms during execution: stop circuit, age of the state, start position and tracking error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.control.last_command import LastCommand
from cell.control.ticks import TICK_S
from robots.errors import Failure, FailureKind
from robots.ports import Array, JointSetpoint, JointState, Ports
from skills.vocabulary import Outcome

__all__ = ["ExecutionLimits", "come_to_rest", "followed", "fresh_state", "hold", "start_mismatch", "stopped"]

SETTLED = 0.01
"""Arms whose joints are all nearer than this to the goal have arrived [rad]."""
SETTLE_S = 1.0
"""Longest wait at the end of a motion until the arms have arrived [s]."""
MAX_ALTERED = 0.002
"""Largest change of a set-point by the driver [rad]."""


@dataclass(frozen=True)
class ExecutionLimits:
    """Limits of a motion's execution, from the group `motion` of the cell's settings.

    start [rad]: largest distance of a joint from the trajectory's first point; tracking [rad]: largest distance
    from the set-point while moving; stale_s: largest age of a joint state [s].
    """

    start: float
    tracking: float
    stale_s: float


def stopped(ports: Ports) -> Failure | None:
    """Return the failure STOPPED if the stop is triggered, else None."""
    stop = ports.stop.state()
    if not stop.stopped:
        return None
    return Failure(
        FailureKind.STOPPED,
        f"the stop was triggered: {stop.reason or 'no reason given'}",
        "clear the cause and reset the stop before starting again",
    )


def fresh_state(ports: Ports, limits: ExecutionLimits) -> Outcome[JointState]:
    """Return the arms' state if it is finite and recent enough to act on, else the failure STALE_STATE."""
    state = ports.arms.state()
    age = ports.clock.now() - state.stamp
    if not np.all(np.isfinite(state.q)):
        what, hint = "the arms report positions that are not numbers", "check the connection to the robot"
        return Outcome(failure=Failure(FailureKind.STALE_STATE, what, hint))
    if age > limits.stale_s:
        return Outcome(
            failure=Failure(
                FailureKind.STALE_STATE,
                f"the arms' state is {age * 1e3:.0f} ms old",
                "check the connection to the robot",
                {"age_s": age, "limit_s": limits.stale_s},
            )
        )
    return Outcome(state)


def followed(
    ports: Ports, q: Array, sent: JointSetpoint, limits: ExecutionLimits, late: bool = False
) -> Outcome[JointState]:
    """Check the arms one tick after the set-point q (joints,) was sent, and return their state. sent: the
    set-point that the driver passed on to the robot. late: the tick came so late that the arms have come to rest
    somewhere else, so their distance from q is not judged.

    Failures: STOPPED, STALE_STATE, LIMIT_EXCEEDED (an altered set-point), TRACKING_ERROR. For the last two, the
    arms are also commanded to hold.
    """
    failure = stopped(ports)
    if failure:
        return Outcome(failure=failure)
    read = fresh_state(ports, limits)
    if read.failure:
        return read
    failure = _altered_setpoint(sent, q, limits)
    failure = failure or (None if late else _tracking_error(read.unwrap(), q, limits))
    if failure:
        hold(ports, limits)
        return Outcome(failure=failure)
    return read


def hold(ports: Ports, limits: ExecutionLimits) -> None:
    """Command the arms to hold their present position.

    If the arms' state is stale, no command is sent, because the arms may have moved far since. The driver then
    holds the arms after its command timeout.
    """
    read = fresh_state(ports, limits)
    if read.ok:
        q = read.unwrap().q
        ports.arms.command(q, np.zeros_like(q))


def come_to_rest(ports: Ports, limits: ExecutionLimits, last_command: LastCommand) -> Failure | None:
    """Wait until the arms have settled at their last set-point, so that a motion can be planned from their
    position.

    Returns a failure if the stop is triggered or the state is stale. Returns None after settle_s even if the arms
    have not settled, because the next motion checks its start position.
    """
    deadline = ports.clock.now() + SETTLE_S
    while last_command.q is not None and ports.clock.now() < deadline:
        read = fresh_state(ports, limits)
        failure = stopped(ports) or read.failure
        if failure or np.abs(read.unwrap().q - last_command.q).max() <= SETTLED:
            return failure
        ports.clock.sleep_until(ports.clock.now() + TICK_S)
    return None


def start_mismatch(state: JointState, q0: Array, limits: ExecutionLimits) -> Failure | None:
    error = np.abs(state.q - q0)
    joint = int(error.argmax())
    if error[joint] <= limits.start:
        return None
    return Failure(
        FailureKind.START_MISMATCH,
        f"joint {joint} stands {np.rad2deg(error[joint]):.1f} degrees from where the trajectory starts",
        "plan again from where the arms are",
        {"joint": joint, "off_rad": float(error[joint]), "limit_rad": limits.start},
    )


def _altered_setpoint(sent: JointSetpoint, q: Array, limits: ExecutionLimits) -> Failure | None:
    """Return LIMIT_EXCEEDED if the driver has altered the set-point, because this would lead the arms off the
    checked path."""
    change = np.abs(sent.q - q)
    joint = int(change.argmax())
    if change[joint] <= MAX_ALTERED:
        return None
    return Failure(
        FailureKind.LIMIT_EXCEEDED,
        f"the driver moved joint {joint}'s set-point by {np.rad2deg(change[joint]):.2f} degrees",
        "compare the robot's own limits with the model's",
        {
            "joint": joint,
            "off_rad": float(change[joint]),
            "limit_rad": MAX_ALTERED,
            "clipped": sent.clipped,
        },
    )


def _tracking_error(state: JointState, q: Array, limits: ExecutionLimits) -> Failure | None:
    error = np.abs(state.q - q)
    joint = int(error.argmax())
    if error[joint] <= limits.tracking:
        return None
    return Failure(
        FailureKind.TRACKING_ERROR,
        f"joint {joint} is {np.rad2deg(error[joint]):.1f} degrees off its set-point",
        "look for an obstacle or a weak motor before you continue",
        {"joint": joint, "off_rad": float(error[joint]), "limit_rad": limits.tracking},
    )
