"""Drivers that break one thing each, made from the sound one of tests/kinematic_cell.py."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from foldcell.cell.support.forwarding import forwarding
from foldcell.robots.ports import CameraFrame, GripperState, JointSetpoint, JointState, Ports, frozen
from tests.kinematic_cell import KinematicCell

Break = Callable[[KinematicCell], Ports]


def with_state(change: Callable[[KinematicCell, JointState], JointState]) -> Break:
    def broken(cell: KinematicCell) -> Ports:
        return replace(cell.ports(), arms=forwarding(cell, state=lambda: change(cell, cell.state())))

    return broken


def with_command(change: Callable[[KinematicCell, Any, Any], JointSetpoint]) -> Break:
    def broken(cell: KinematicCell) -> Ports:
        return replace(cell.ports(), arms=forwarding(cell, command=lambda q, qd: change(cell, q, qd)))

    return broken


def with_gripper(**own: Callable[..., Any]) -> Break:
    """own: methods that get the hand first."""

    def broken(cell: KinematicCell) -> Ports:
        def broken_hand(hand: Any) -> Any:
            return forwarding(hand, **{k: lambda *a, f=f: f(hand, *a) for k, f in own.items()})

        ports = cell.ports()
        return replace(ports, grippers={side: broken_hand(hand) for side, hand in ports.grippers.items()})

    return broken


def with_stop(change: Callable[[KinematicCell, Callable[[str], None]], Callable[[str], None]]) -> Break:
    def broken(cell: KinematicCell) -> Ports:
        ports = cell.ports()
        return replace(ports, stop=forwarding(ports.stop, trigger=change(cell, ports.stop.trigger)))

    return broken


def with_picture(change: Callable[[CameraFrame], CameraFrame]) -> Break:
    def broken(cell: KinematicCell) -> Ports:
        return replace(cell.ports(), camera=forwarding(cell, capture=lambda: change(cell.capture())))

    return broken


def writable(_: KinematicCell, state: JointState) -> JointState:
    return replace(state, q=np.array(state.q))


def degrees(_: KinematicCell, state: JointState) -> JointState:
    return replace(state, q=frozen(np.rad2deg(state.q)))


def wall_clock(_: KinematicCell, state: JointState) -> JointState:
    return replace(state, stamp=state.stamp + 1.8e9)


def first_two_exchanged(cell: KinematicCell, state: JointState) -> JointState:
    order = np.arange(len(state.q))
    order[:2] = 1, 0
    rest = cell.model.q_park
    return replace(state, q=frozen(rest + (state.q - rest)[order]), qd=frozen(state.qd[order]))


def fast(_: KinematicCell, state: JointState) -> JointState:
    return replace(state, qd=frozen(2.0 * state.qd))


def delayed_in(seconds: float, period: float) -> Break:
    """In each period the gripper's states stay away for so long [s]."""

    def broken(cell: KinematicCell) -> Ports:
        last: dict[Any, GripperState] = {}

        def state(hand: Any) -> GripperState:
            if hand.side not in last or cell.t % period >= seconds:
                last[hand.side] = hand.state()
            return last[hand.side]

        return with_gripper(state=state)(cell)

    return broken


def fresh_stamp(cell: KinematicCell, state: JointState) -> JointState:
    return replace(state, stamp=cell.t)


def nan_is_zero(cell: KinematicCell, q: Any, qd: Any) -> JointSetpoint:
    return cell.command(np.nan_to_num(q, posinf=0.0), np.nan_to_num(qd, posinf=0.0))


def as_requested(cell: KinematicCell, q: Any, qd: Any) -> JointSetpoint:
    sent = cell.command(q, qd)
    return JointSetpoint(sent.stamp, frozen(np.array(q)), frozen(np.array(qd)), False)


def never_holds(cell: KinematicCell) -> Ports:
    """The controller goes on with the last velocity."""

    def sleep_until(t: float) -> None:
        while cell.t < t - 1e-9:
            if cell.setpoint is not None and not cell.reason and cell.t - cell.setpoint.stamp > 0.02:
                sent = cell.setpoint
                cell.setpoint = replace(sent, stamp=cell.t, q=frozen(sent.q + 0.02 * sent.qd))
            cell.sleep_until(min(t, cell.t + 0.01))

    return replace(cell.ports(), clock=forwarding(cell, sleep_until=sleep_until))


def motors_on_after_a_reset(cell: KinematicCell) -> Ports:
    ports = cell.ports()

    def reset() -> None:
        ports.stop.reset()
        cell.enabled = True

    return replace(ports, stop=forwarding(ports.stop, reset=reset))


def brakes_late(cell: KinematicCell) -> Ports:
    """The robot goes on with its last velocity for a second after the stop."""
    ports, before = cell.ports(), cell.sleep_until

    def sleep_until(t: float) -> None:
        coasts = cell.reason and cell.t - cell.stop_at < 1.0 and np.abs(cell.qd).max() > 0.01
        q, qd = cell.q.copy(), cell.qd.copy()
        begun = cell.t
        before(t)
        if coasts:
            cell.q, cell.qd = q + qd * (cell.t - begun), qd

    return replace(ports, clock=forwarding(cell, sleep_until=sleep_until))


def on_its_own_thread(cell: KinematicCell, trigger: Callable[[str], None]) -> Callable[[str], None]:
    own = threading.current_thread()

    def only_here(reason: str) -> None:
        if threading.current_thread() is own:
            trigger(reason)

    return only_here


def never_moving(hand: Any) -> GripperState:
    return replace(hand.state(), moving=False)


def forgetful(hand: Any, opening: float, force: float) -> None:
    before = hand.calibrating, hand.after
    hand.command(opening, force)
    if before[0] > 0.0:
        hand.after = before[1]


def mirrored(cell: KinematicCell) -> Ports:
    return replace(cell.ports(), head=forwarding(cell, command_pan=lambda angle: cell.command_pan(-angle)))


def same_number(frame: CameraFrame) -> CameraFrame:
    return replace(frame, sequence=7)


def unregistered(frame: CameraFrame) -> CameraFrame:
    return replace(frame, depth=frame.depth[::2, ::2])


def along_the_ray(frame: CameraFrame) -> CameraFrame:
    k = frame.intrinsics
    v, u = np.mgrid[0 : k.height, 0 : k.width].astype(np.float32)
    longer = np.sqrt(1.0 + ((u - k.cx) / k.fx) ** 2 + ((v - k.cy) / k.fy) ** 2)
    return replace(frame, depth=frozen((frame.depth * longer).astype(np.float32)))


BROKEN: dict[str, tuple[Break, str]] = {
    "writable arrays": (with_state(writable), "shapes"),
    "degrees": (with_state(degrees), "units"),
    "stamps of the wall clock": (with_state(wall_clock), "stamps"),
    "grippers whose states come late": (delayed_in(0.3, 0.6), "stamps"),
    "motors on after a reset": (motors_on_after_a_reset, "stop at rest"),
    "NaN taken for 0": (with_command(nan_is_zero), "refusals"),
    "a stop for one thread": (with_stop(on_its_own_thread), "two threads"),
    "the requested set-point returned": (with_command(as_requested), "clipping"),
    "no hold": (never_holds, "hold"),
    "late brakes": (brakes_late, "stop in motion"),
    "invented stamps": (with_state(fresh_stamp), "stale state"),
    "two joints exchanged": (with_state(first_two_exchanged), "joint order"),
    "velocities doubled": (with_state(fast), "velocities"),
    "a gripper that never moves": (with_gripper(state=never_moving), "gripper"),
    "a gripper that forgets": (with_gripper(command=forgetful), "gripper orders"),
    "a mirrored head": (mirrored, "head"),
    "one number for all pictures": (with_picture(same_number), "camera"),
    "depth of another size": (with_picture(unregistered), "depth"),
    "depth along the ray": (with_picture(along_the_ray), "depth"),
}  # fmt: skip
"""Name -> driver, and the clause that it breaks."""
