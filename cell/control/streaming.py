"""Streaming a checked trajectory to the arms at 100 Hz, and watching that they follow.

Where motions become set-points (hands at work command theirs in effects/hands.py and gripping.py, with the same
looks after each: `followed`). Every tick reads the arms back: stopped, stale or straying arms end the motion with
a typed failure, and so does whatever a caller watches for (a slipping garment). Arms that stray are told to hold
where they are; every other end and a pause run the motion's clock (path_clock.py) down, so that the arms come to
rest on the path that was checked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cell.control.path_clock import PathClock, PathControl
from cell.control.sent import Sent, faded
from cell.control.ticks import TICK_S, Ticks
from cell.states.commands import ABORTED
from cell.states.transition_table import Event
from robots.errors import Failure, FailureKind
from robots.ports import ArmTrajectory, Array, JointSetpoint, JointState, Ports
from skills.vocabulary import Outcome

__all__ = [
    "ExecutionLimits",
    "Tick",
    "Watch",
    "come_to_rest",
    "followed",
    "fresh_state",
    "hold",
    "start_mismatch",
    "stream",
    "wait",
]


@dataclass(frozen=True)
class ExecutionLimits:
    """What a motion is held to.

    start [rad]: how far the arms may stand from a trajectory's first point; tracking [rad]: from the set-point
    while moving; settled [rad], settle_s: when a motion counts as arrived; stale_s: oldest joint state. sent
    [rad]: how much a driver may alter a set-point.
    """

    start: float = np.deg2rad(1.0)
    tracking: float = 0.12
    settled: float = 0.01
    settle_s: float = 1.0
    stale_s: float = 0.1
    sent: float = 0.002


@dataclass(frozen=True, eq=False)
class Tick:
    """What a watcher sees: time on the motion's own clock [s], which a pause holds up, and the arms' state."""

    t: float
    state: JointState


Watch = Callable[[Tick], Failure | None]


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


def come_to_rest(ports: Ports, limits: ExecutionLimits, sent: Sent) -> Failure | None:
    """Let arms that are off their last set-point come back to it before anything is planned from where they stand:
    a sudden drop takes a moment. Those that do not within settle_s are left to the checks of the next motion."""
    deadline = ports.clock.now() + limits.settle_s
    while sent.q is not None and ports.clock.now() < deadline:
        read = fresh_state(ports, limits)
        failure = stopped(ports) or read.failure
        if failure or np.abs(read.unwrap().q - sent.q).max() <= limits.settled:
            return failure
        ports.clock.sleep_until(ports.clock.now() + TICK_S)
    return None


def wait(
    ports: Ports,
    seconds: float,
    limits: ExecutionLimits,
    watch: Watch | None = None,
    sent: Sent | None = None,
) -> Failure | None:
    """Hold where the arms stand for some cell time, watched as in a motion. Ends early on a failure: those of
    `followed`, or what `watch` returned.

    Arms of which nothing recent is known are told nothing, as in `hold`: the next motion refuses them.
    """
    sent = sent or Sent()
    read = fresh_state(ports, limits)
    q = read.unwrap().q if read.ok else None
    offset = np.zeros(14) if q is None else sent.offset(q)
    ticks = Ticks(ports)
    for k in range(max(1, round(seconds / TICK_S))):
        if q is None:
            ticks.wait()
            failure = stopped(ports)
        else:
            sent.q = held = q + faded(k) * offset
            told = ports.arms.command(held, np.zeros_like(q))
            ticks.wait()
            failure = followed(ports, held, told, limits).failure
            if failure:
                sent.q = None
        failure = failure or (watch(Tick((k + 1) * TICK_S, ports.arms.state())) if watch else None)
        if failure:
            return failure
    return None


def stream(
    ports: Ports,
    trajectory: ArmTrajectory,
    limits: ExecutionLimits,
    watch: Watch | None = None,
    control: PathControl | None = None,
) -> Outcome[JointState]:
    """Send the trajectory and see it through. Returns the state in which the arms came to rest.

    Failures: STOPPED, STALE_STATE, START_MISMATCH, TRACKING_ERROR, ABORTED, or what `watch` returned. With a
    `control` a motion can be paused: its clock runs down, the arms rest on the path, still watched, and go on when
    told to, if they stand where they came to rest. What ends a motion early brings it to rest on the path in the
    same way, but for arms that stray: these hold where they are.
    """
    start = fresh_state(ports, limits)
    failure = stopped(ports) or start.failure or start_mismatch(start.unwrap(), trajectory.q[0], limits)
    if failure:
        return Outcome(failure=failure)
    motion = _Motion(ports, trajectory, limits, watch, control)
    return motion.run()


class _Motion:
    """One trajectory under way: what `stream` keeps from tick to tick."""

    def __init__(
        self,
        ports: Ports,
        trajectory: ArmTrajectory,
        limits: ExecutionLimits,
        watch: Watch | None,
        control: PathControl | None,
    ) -> None:
        self._ports, self._trajectory, self._limits, self._watch = ports, trajectory, limits, watch
        self._control = control
        self._path = PathClock(trajectory, control) if control else None
        self._ending: Failure | None = None
        """Why the motion is being brought to rest, when that is to end it."""
        self._settling = 0.0
        self._asked: float | None = None
        """When the pause was asked for that is not in the ledger yet [s]."""

    def run(self) -> Outcome[JointState]:
        ports = self._ports
        ticks, k, t = Ticks(ports), 0, 0.0
        offset = self._control.sent.offset(self._trajectory.q[0]) if self._control else np.zeros(14)
        while True:
            q, qd = self._path.setpoint() if self._path else self._trajectory.at(t)
            arrived = self._path.arrived if self._path else t >= self._trajectory.duration
            q = q + faded(k) * offset
            sent = ports.arms.command(q, qd)
            if self._control:
                self._control.sent.q = q
            k += 1
            stalled = ticks.wait()
            if self._path:
                if not (stalled and self._path.begin_again()):
                    self._path.advance()
                t = self._path.t
            else:
                t = k * TICK_S
            outcome = self._judge(q, sent, t, arrived)
            if outcome is not None:
                return Outcome(outcome.value, outcome.failure, {"motion_s": k * TICK_S})

    def _judge(self, q: Array, sent: JointSetpoint, t: float, arrived: bool) -> Outcome[JointState] | None:
        """After a tick: how the motion ended, or None while it goes on."""
        read = followed(self._ports, q, sent, self._limits)
        if read.failure:
            if read.failure.kind is FailureKind.STALE_STATE:
                return self._bring_to_rest(read.failure)
            if self._control:
                self._control.sent.q = None
            return read
        state = read.unwrap()
        failure = self._watch(Tick(t, state)) if self._watch else None  # also while it is brought to rest
        if failure or self._ending:
            return self._bring_to_rest(self._ending or failure)
        self._settling += TICK_S if arrived else 0.0
        off = float(np.abs(state.q - self._trajectory.q[-1]).max())
        if arrived and (off < self._limits.settled or self._settling >= self._limits.settle_s):
            return Outcome(state)
        return self._heed(state, q)

    def _bring_to_rest(self, failure: Failure | None) -> Outcome[JointState] | None:
        """Run the clock down, then end with `failure`. Without a clock of its own the motion ends at once."""
        assert failure is not None
        if self._path is None:
            hold(self._ports, self._limits)
            return Outcome(failure=failure)
        if self._ending is None:
            self._ending = failure
            if not self._path.stopping and not self._path.resting:
                self._path.stop()
        return Outcome(failure=self._ending) if self._path.resting else None

    def _heed(self, state: JointState, q: Array) -> Outcome[JointState] | None:
        """What the operator says to a motion: pause it, go on, end it."""
        if self._control is None or self._path is None or self._control.commands is None:
            return None
        if self._path.resting:
            self._control.waited_s += TICK_S
            self._keep_pause()
            said = self._control.answer()
            if said is Event.RESUME:
                mismatch = start_mismatch(state, q, self._limits)
                if mismatch:
                    return Outcome(failure=mismatch)
                self._control.note("resumed", {"path_s": self._path.t})
                self._control.tell("going on")
                self._path.go()
            return Outcome(failure=ABORTED) if said is Event.ABORT else None
        if not self._path.stopping:
            said = self._control.wanted()
            if said is Event.PAUSE:
                self._control.tell("coming to rest on the way")
                self._asked = self._ports.clock.now()
                self._path.stop()
            if said is Event.ABORT:
                return self._bring_to_rest(ABORTED)
        return None

    def _keep_pause(self) -> None:
        """In the ledger, once the arms rest: the disk does not keep moving arms waiting."""
        assert self._control is not None and self._path is not None
        if self._asked is not None:
            self._control.note("paused", {"asked_s": self._asked, "path_s": self._path.t})
            self._control.tell("paused on the way: resume or abort")
            self._asked = None


def _altered(sent: JointSetpoint, q: Array, limits: ExecutionLimits) -> Failure | None:
    """A driver that sends something else than it was told leads the arms off the path."""
    off = np.abs(sent.q - q)
    joint = int(off.argmax())
    if off[joint] <= limits.sent:
        return None
    return Failure(
        FailureKind.LIMIT_EXCEEDED,
        f"the driver moved joint {joint}'s set-point by {np.rad2deg(off[joint]):.2f} degrees",
        "compare the robot's own limits with the model's",
        {"joint": joint, "off_rad": float(off[joint]), "limit_rad": limits.sent, "clipped": sent.clipped},
    )


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
