"""Clauses about the arms and the stop: refusals, clipping, small motions, holding, stopping."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from foldcell.cell.control.motion import Tick
from foldcell.cell.control.ticks import TICK_S
from foldcell.cell.hardware.contract.rig import REASON, Rig, UnprovenError, require
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, JointState
from foldcell.robots.setpoint import JUMP_TIME

STOPPED, FAULT = FailureKind.STOPPED, FailureKind.HARDWARE_FAULT
STOP_S = 0.5
"""Time in which stopped arms come to rest [s]."""
HOLD_S = 0.5
"""The same for arms without a command, after the command timeout [s]."""
STILL_S, STILL = 0.3, 0.004
"""Arms rest if no joint turns by more than STILL [rad] in this time [s]."""
SLOW = 0.03
"""Speed of a joint at which the time to rest ends, above the noise of readings [rad/s]."""
TURN, FAR = 0.15, 0.6
"""Turn of the wrists in a motion, and the distance of a set-point that is too far [rad]."""
JOINT_TURN, OTHERS = 0.03, 0.012
"""Turn of a single joint, and what the other joints may turn meanwhile [rad]."""
NEAR = 0.002
"""Distance of a set-point that no driver may clip [rad]."""
AGREES = 0.3
"""Relative error of a measured turn or velocity."""


def refusals(rig: Rig) -> None:
    rig.ready()
    command, q, still = rig.ports.arms.command, rig.state.q, np.zeros(len(rig.model.q_park))
    for what, wrong in (("not a number", np.nan), ("infinite", np.inf)):
        spoiled = q.copy()
        spoiled[0] = wrong
        rig.refused(partial(command, spoiled, still), f"a position that is {what}")
        rig.refused(partial(command, q, spoiled), f"a velocity that is {what}")
    rig.refused(partial(command, q[:-1], still[:-1]), "a set-point that lacks a joint")
    rig.wait(STILL_S)
    turned = float(np.abs(rig.state.q - q).max())
    require(turned < 2 * STILL, f"a refused set-point turned a joint by {turned:.3f} rad")


def stop_at_rest(rig: Rig) -> None:
    """Stop the arms with their motors on, with their motors off, and while the grippers calibrate."""
    rig.ready()
    _stop(rig, "arms at rest")
    rig.ports.stop.reset()
    require(not rig.ports.stop.state().stopped, "the robot is still stopped after a reset")
    rig.refused(rig.hold_command, "a set-point after a reset without `enable`", FAULT)
    _stop(rig, "arms without power")
    rig.ready()
    for gripper in rig.ports.grippers.values():
        gripper.calibrate()
    _stop(rig, "grippers that calibrate")
    rig.ready()
    rig.hold_command()


def stop_in_motion(rig: Rig) -> Mapping[str, float]:
    """Measure the time from the stop to rest [s]."""
    rig.ready()
    rig.drive(rig.plan(rig.wrists(TURN)), 0.5)
    rest_s = _stop(rig, "arms in motion")
    rig.ready()
    return {"rest_s": rest_s}


def _stop(rig: Rig, of: str) -> float:
    """Trigger the stop. It has to be reported and to refuse commands at once, and to bring the arms to rest.
    Returns the time to rest [s]."""
    begun = rig.now
    rig.ports.stop.trigger(REASON)
    rig.ports.stop.trigger("a second stop")
    stop = rig.ports.stop.state()
    require(stop.stopped, f"{of}: the stop is not reported")
    require(REASON in stop.reason, f"{of}: the stop has the reason {stop.reason!r}")
    rig.refused(rig.hold_command, f"{of}: a set-point after the stop", STOPPED)
    rig.refused(rig.ports.arms.enable, f"{of}: `enable` during the stop", STOPPED)
    seen = [(t - begun, rig.state.qd) for t in rig.ticks(STOP_S)]
    _rests(rig, f"{of}: {STOP_S:g} s after the stop")
    require(rig.ports.stop.state().stopped, f"{of}: the stop has ended by itself")
    return max((t for t, qd in seen if np.abs(qd).max() > SLOW), default=0.0)


def _rests(rig: Rig, when: str) -> Array:
    q = rig.state.q
    for _ in rig.ticks(STILL_S):
        turned = float(np.abs(rig.state.q - q).max())
        require(turned < STILL, f"{when}, a joint still turns ({turned:.3f} rad in {STILL_S:g} s)")
    return q


def clipping(rig: Rig) -> None:
    rig.ready()
    arms, limits = rig.ports.arms, rig.model.protective
    q, zero, before = rig.state.q, np.zeros(len(rig.model.q_park)), rig.now
    near = q + rig.wrists(NEAR)
    sent = arms.command(near, zero)
    require(np.abs(sent.q - near).max() < 1e-9 and not sent.clipped, "a set-point nearby is not sent as it is")
    off = sent.stamp - before
    require(-TICK_S <= off <= rig.now - before + 1e-6, f"the set-point's stamp is {off:.3f} s off")
    rig.wait(0.2)
    direction = np.sign(rig.plan(rig.wrists(FAR)).q[-1] - rig.state.q) * (rig.wrists(1.0) > 0.0)
    far, fast = rig.state.q + FAR * direction, 10.0 * limits.velocity * direction
    stands, reach = rig.state.q, limits.velocity * JUMP_TIME
    sent = arms.command(far, fast)
    rig.ports.clock.sleep_until(rig.now + TICK_S)
    rig.hold_command()
    step = float((np.abs(sent.q - stands) - reach).max())
    require(sent.clipped, f"a set-point {FAR} rad away, at ten times full speed, is not reported as clipped")
    require(step < 0.02, f"a set-point {FAR} rad away is sent {step:.2f} rad further than one step may go")
    require((np.abs(sent.qd) <= limits.velocity + 1e-9).all(), "a velocity above the joint's limit is sent")
    require(((sent.q >= limits.lower) & (sent.q <= limits.upper)).all(), "a set-point out of range is sent")
    rig.wait(rig.ports.arms.command_timeout)
    turned = float(np.abs(rig.state.q - stands).max())
    require(turned < reach.max() + 0.05, f"a set-point too far away turned a joint by {turned:.2f} rad")


@dataclass(eq=False)
class _Seen:
    """The joint states of a motion."""

    states: list[JointState] = field(default_factory=list)

    def watch(self, tick: Tick) -> None:
        self.states.append(tick.state)


def joint_order(rig: Rig) -> None:
    rig.ready()
    begun, joints = rig.state.q, len(rig.model.q_park)
    for k in range(joints):
        before, seen = rig.state.q, _Seen()
        rig.move(JOINT_TURN * np.eye(joints)[k], seen.watch)
        turned = np.abs(rig.state.q - before)
        name, most = rig.model.joint_names[k], rig.model.joint_names[int(turned.argmax())]
        require(turned.argmax() == k, f"{name} was commanded, and {most} turned")
        off = abs(turned[k] / JOINT_TURN - 1.0)
        require(off < AGREES, f"{name} was to turn by {JOINT_TURN} rad and reports {turned[k]:.3f} rad")
        others = np.delete(turned, k).max()
        require(others < OTHERS, f"{name} was commanded, and another joint turned by {others:.3f} rad")
    rig.move(begun - rig.state.q)


def velocities(rig: Rig) -> None:
    rig.ready()
    seen, offset = _Seen(), rig.wrists(TURN)
    rig.move(offset, seen.watch)
    t = np.array([state.stamp for state in seen.states])
    qd = np.array([state.qd for state in seen.states])
    travelled = seen.states[-1].q - seen.states[0].q
    integral = (0.5 * (qd[1:] + qd[:-1]) * np.diff(t)[:, None]).sum(axis=0)
    for k in np.flatnonzero(offset):
        name = rig.model.joint_names[int(k)]
        require(
            abs(integral[k] - travelled[k]) < AGREES * TURN,
            f"{name} turned by {travelled[k]:.3f} rad, and its velocities add up to {integral[k]:.3f} rad",
        )
    rig.ready()
    rig.move(-travelled * (offset > 0.0))


def hold(rig: Rig) -> None:
    rig.ready()
    timeout = rig.ports.arms.command_timeout
    q, qd = rig.drive(rig.plan(rig.wrists(TURN)), 0.5)
    rig.wait(timeout + HOLD_S)
    stands = _rests(rig, f"{timeout + HOLD_S:g} s after the last set-point")
    further, most = np.abs(stands - q), np.abs(qd) * (timeout + HOLD_S) + 0.02
    require((further < most).all(), f"without set-points the arms went on by {further.max():.2f} rad")
    rig.hold_command()  # the motors are still on


def stale_state(rig: Rig) -> None:
    if rig.interrupt is None:
        raise UnprovenError("nothing interrupts the joint states of this driver")
    rig.ready()
    rig.interrupt(1.0)
    try:
        _interrupted(rig)
    finally:
        rig.wait(0.8)
    require(rig.within(1.0, lambda: rig.now - rig.state.stamp < 0.1), "the joint states do not come back")


def _interrupted(rig: Rig) -> None:
    ages = [rig.now - rig.state.stamp for _ in rig.ticks(0.5)]
    age, q = ages[-1], rig.state.q
    require(age > rig.ports.arms.command_timeout, f"an interrupted joint state is only {age:.2f} s old")
    command = partial(rig.ports.arms.command, q, np.zeros_like(q))
    rig.refused(command, "a set-point without joint states", FailureKind.STALE_STATE)


def two_threads(rig: Rig) -> None:
    """Poll and trigger the stop on another thread while this one commands."""
    rig.ready()
    over, errors = threading.Event(), list[BaseException]()

    def poll() -> None:
        try:
            while not over.wait(1e-3):
                rig.ports.stop.state()
        except BaseException as error:
            errors.append(error)

    polling = threading.Thread(target=poll)
    polling.start()
    try:
        for _ in rig.ticks(0.3):
            rig.hold_command()
    finally:
        over.set()
        polling.join()
    require(not errors, f"`Stop.state` fails on another thread: {errors[:1]}")
    triggering = threading.Thread(target=rig.ports.stop.trigger, args=(REASON,))
    triggering.start()
    triggering.join()
    require(rig.ports.stop.state().stopped, "a stop that another thread triggers is not reported")
    rig.refused(rig.hold_command, "a set-point after a stop by another thread", STOPPED)
    rig.ready()


def reconnect(rig: Rig) -> None:
    """Check a connection that was opened after another one was closed."""
    require(rig.within(1.0, lambda: rig.now - rig.state.stamp < 0.1), "the new connection has no joint state")
    _rests(rig, "before the first set-point")
    rig.ready()
    rig.hold_command()
