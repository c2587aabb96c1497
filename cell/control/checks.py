"""Checks of the arms during execution: stop circuit, age of the state, frozen state, start position and tracking
error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import Array, JointSetpoint, JointState, Ports
from foldcell.skills.vocabulary import Outcome

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
    from the set-point while moving; stale_s: largest age of a joint state [s]; latency_s: time that a set-point
    and the reading that shows it are on the network together [s].
    """

    start: float
    tracking: float
    stale_s: float
    latency_s: float = 0.0


def stopped(ports: Ports) -> Failure | None:
    """Return the failure STOPPED if the stop is triggered, else None."""
    stop = ports.stop.state()
    if not stop.stopped:
        return None
    return Failure(
        FailureKind.STOPPED,
        f"the stop was triggered: {stop.reason or 'no reason given'}",
        "clear the cause"
        + ("" if ports.simulated else ", reset the stop (`foldcell reset`)")
        + ", then resume or begin anew",
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
    ports: Ports,
    q: Array,
    sent: JointSetpoint,
    limits: ExecutionLimits,
    late: bool = False,
    earlier: Sequence[Array] = (),
) -> Outcome[JointState]:
    """Check the arms one tick after the set-point q (joints,) was sent, and return their state. sent: the
    set-point that the driver passed on to the robot. late: the tick came so late that the arms have come to rest
    somewhere else, so their distance from q is not judged. earlier: the set-points (joints,) that the reading may
    show instead of q, because both were on the network; a joint may be anywhere between them.

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
    failure = failure or (None if late else _tracking_error(read.unwrap(), [*earlier, q], limits))
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
    """Return START_MISMATCH if the arms do not stand at q0 (joints,), where a motion starts [rad]."""
    what = "joint {joint} stands {off:.1f} degrees from where the trajectory starts"
    hint = "plan again from where the arms are"
    return _beyond(state.q - q0, limits.start, FailureKind.START_MISMATCH, what, hint)


def _altered_setpoint(sent: JointSetpoint, q: Array, limits: ExecutionLimits) -> Failure | None:
    """Return LIMIT_EXCEEDED if the driver has altered the set-point, because this would lead the arms off the
    checked path."""
    what = "the driver moved joint {joint}'s set-point by {off:.2f} degrees"
    hint = "compare the robot's own limits with the model's"
    failure = _beyond(sent.q - q, MAX_ALTERED, FailureKind.LIMIT_EXCEEDED, what, hint)
    return failure and replace(failure, values={**failure.values, "clipped": sent.clipped})


def _tracking_error(state: JointState, shown: Sequence[Array], limits: ExecutionLimits) -> Failure | None:
    what = "joint {joint} is {off:.1f} degrees off its set-point"
    hint = "look for an obstacle or a weak motor before you continue"
    off = state.q - np.clip(state.q, np.min(shown, axis=0), np.max(shown, axis=0))
    return _beyond(off, limits.tracking, FailureKind.TRACKING_ERROR, what, hint)


def _beyond(off: Array, limit: float, kind: FailureKind, what: str, hint: str) -> Failure | None:
    """Return a failure if the largest distance in `off` (joints,) exceeds the limit [rad]. what: names the
    joint and the distance in degrees."""
    joint = int(np.abs(off).argmax())
    distance = float(np.abs(off[joint]))
    if distance <= limit:
        return None
    values = {"joint": joint, "off_rad": distance, "limit_rad": limit}
    return Failure(kind, what.format(joint=joint, off=np.rad2deg(distance)), hint, values)


FROZEN_S = 0.1
"""If the positions of moving arms stay the same for longer than this, they are no readings [s]. Encoders have
noise, and no arm follows its set-points without turning a joint by their resolution."""
FROZEN_RAD = 0.005
"""Positions count as frozen only if the set-points have moved at least this far in that time [rad]. Encoders of
arms at rest may repeat their positions."""


@dataclass(eq=False)
class FrozenStateWatch:
    """Detects joint states that have stopped changing although the arms are being moved. It keeps the last
    position that differed from the position before, the time of this reading, and the set-point at that time.

    The check of the tracking error detects such a state only when the set-points have gone far enough, and never
    near the end of a motion.
    """

    _q: Array | None = None
    _since: float = 0.0
    _setpoint: Array | None = None

    def check(self, state: JointState, setpoint: Array) -> Failure | None:
        """Return STALE_STATE if the positions (joints,) have been exactly the same for more than FROZEN_S, by
        their stamps, while the set-points (joints,) have moved by FROZEN_RAD. Called once per set-point."""
        if self._q is None or self._setpoint is None or not np.array_equal(state.q, self._q):
            self._q, self._since, self._setpoint = state.q, state.stamp, setpoint
            return None
        seconds, moved = state.stamp - self._since, float(np.abs(setpoint - self._setpoint).max())
        if seconds <= FROZEN_S or moved < FROZEN_RAD:
            return None
        return Failure(
            FailureKind.STALE_STATE,
            f"the arms' positions have been exactly the same for {seconds * 1e3:.0f} ms, "
            f"while the set-points moved by {np.rad2deg(moved):.1f} degrees",
            "check the connection to the robot, and that its encoders are read",
            {"frozen_s": seconds, "moved_rad": moved},
        )
