"""Effects that take hold, fold and let go: where the arms and the hands' controllers work together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cell.control.sent import faded
from cell.control.streaming import Tick, Watch, followed, stream
from cell.control.ticks import TICK_S, Ticks
from cell.executive.effects.hands import (
    comes_to_rest,
    command_grip,
    each_hand,
    lowered,
    read_hand,
    telemetry,
    tool_height,
)
from cell.executive.effects.moving import PREGRASP_OPENING, move, pausable, waited
from cell.executive.effects.pushing import Pushes
from cell.hardware.workcell import Workcell
from cell.states.context import Context, Result
from cell.states.recovery_table import Adjustment
from cell.states.transition_table import Event
from robots.errors import DriverError, Failure, FailureKind
from robots.ports import Array, CameraFrame, Side, arm_slice
from skills.grasping.close import close, start_close
from skills.grasping.confirm import Expectation, Held, confirm, start_confirm
from skills.grasping.descend import Contact, DescentGoal, DescentState, descend, start_descent
from skills.grasping.hand_reading import HandReading
from skills.grasping.lift import check_lift, start_lift_check
from skills.grasping.release import release, start_release
from skills.grasping.settings import GraspSettings
from skills.grasping.slip import start_slip_watch, watch_slip
from skills.grasping.tare import start_zero, zero
from skills.motion.moves.arc import plan_arc
from skills.motion.moves.grasp import Descent
from skills.motion.moves.lift import plan_lift
from skills.motion.timing.jerk_limiter import Follower
from skills.vocabulary import Grasp, Outcome

__all__ = ["fold", "grasp", "lift", "release_garment"]

RELEASE_OPENING = 0.020
"""Wide enough to let go, too narrow to sweep the stack [m]."""
PRESS = 0.001
"""Past the touch, so that the pads close under the cloth [m]."""
DEEPER = 0.002
"""How much lower each further try presses [m]."""
STRONGER = 1.4
PRESS_S = 0.4


def grip_settings(cell: Workcell, context: Context) -> GraspSettings:
    """The settings, with the force that recoveries have raised."""
    return replace(cell.grasp, grip_force=cell.grasp.grip_force * STRONGER ** context.count(Adjustment.STRONGER))


def grasp(cell: Workcell, context: Context) -> Result:
    """Down until the tips touch, press into the stack, close, and feel what is held."""
    assert context.motion is not None
    ways = context.motion.descend
    settings = grip_settings(cell, context)
    zeros = each_hand(cell, {s: start_zero(settings) for s in ways}, lambda side, r, s: zero(r, s))
    if zeros.failure:
        return Result(Event.FAILED, context.with_failure(zeros.failure))
    context = replace(context, zeros=zeros.unwrap())
    hands = {s: Follower(0.0) for s in ways}
    contacts = _descend(cell, context, ways, settings, hands)
    if contacts.failure:
        return Result(Event.FAILED, context.with_failure(contacts.failure))
    pushes = Pushes(cell, context.zeros)
    failure = _press(cell, context, ways, hands, pushes)
    record: dict[str, object] = {
        "contact_height_m": {s.value: c.height for s, c in contacts.unwrap().items()},
        "contact_by": {s.value: c.by for s, c in contacts.unwrap().items()},
        "strongest_push_n": pushes.strongest,
    }
    if failure:
        return Result(Event.FAILED, context.with_failure(failure), record)
    held = _close_and_confirm(cell, context, settings)
    if held.failure:
        return Result(Event.FAILED, context.with_failure(held.failure), record)
    record |= {"held": {s.value: {"grip_n": h.grip, "opening_m": h.opening} for s, h in held.unwrap().items()}}
    return Result(Event.DONE, replace(context, held=held.unwrap()), record)


def lift(cell: Workcell, context: Context) -> Result:
    """A little way straight up; what was held must still be held."""
    q = cell.ports.arms.state().q
    sides = tuple(context.held)
    up = plan_lift(cell.robot, cell.guard, q, sides, cell.settings.grasp.lift_height, limits=cell.limits)
    control = pausable(cell)
    failure = up.failure or move(cell, up.unwrap(), fingertips=True, control=control)
    context = waited(context, control)
    if failure:
        return Result(Event.FAILED, context.with_failure(failure))
    checks = {s: start_lift_check(cell.grasp, context.zeros[s], held) for s, held in context.held.items()}
    kept = each_hand(cell, checks, lambda side, r, s: check_lift(r, s))
    if kept.failure:
        return Result(Event.FAILED, context.with_failure(kept.failure))
    return Result(Event.DONE, replace(context, held=kept.unwrap()))


def fold(cell: Workcell, context: Context) -> Result:
    """Along the arc, from where the hands really are, watching for a slip and taking the key pictures."""
    assert context.motion is not None
    arc = plan_arc(
        cell.robot, cell.guard, cell.table, context.planned_paths, context.motion.postures,
        cell.ports.arms.state().q, limits=cell.limits, tool_speed=context.tool_speed, rng=cell.rng(),
    )  # fmt: skip
    if arc.failure:
        return Result(Event.FAILED, context.with_failure(arc.failure))
    trajectory = arc.unwrap().fold
    pictures: list[CameraFrame] = []
    moments = np.linspace(0.0, trajectory.duration, cell.settings.recorder.key_frames)
    watch = _all_of(_slip_watch(cell, context), _photographer(cell, context, moments, pictures))
    control = pausable(cell)
    moved = stream(cell.ports, trajectory, cell.execution, telemetry(cell, watch), control)
    executed = replace(context.motion, arc=arc.unwrap())  # what is learned from the fold is learned from this way
    context = replace(waited(context, control), pictures=tuple(pictures), motion=executed)
    if moved.failure:
        return Result(Event.FAILED, context.with_failure(moved.failure))
    return Result(Event.DONE, context, {"duration_s": trajectory.duration})


def release_garment(cell: Workcell, context: Context) -> Result:
    """Open just wide enough above the stack."""
    context = replace(context, carried=True)
    state = cell.ports.arms.state()
    states = {s: start_release(cell.grasp, RELEASE_OPENING, read_hand(cell, s, state)) for s in context.held}

    def tick(side: Side, reading: HandReading, state):  # type: ignore[no-untyped-def]
        command, after = release(reading, state)
        command_grip(cell, side, command)
        return after

    opened = each_hand(cell, states, tick)
    if opened.failure:
        return Result(Event.FAILED, context.with_failure(opened.failure))
    return Result(Event.DONE, replace(context, held={}))


def _descend(
    cell: Workcell,
    context: Context,
    ways: Mapping[Side, Descent],
    settings: GraspSettings,
    hands: dict[Side, Follower],
) -> Outcome[dict[Side, Contact]]:
    """hands: how far down its way each set-point is [m], and how it moves; kept up to date."""
    assert context.motion is not None
    state = cell.ports.arms.state()
    top = {s: tool_height(cell, s, state.q) for s in ways}
    goals = {s: _goal(cell, context, s, top[s] - float(way.depth[-1])) for s, way in ways.items()}
    states = {s: start_descent(settings, goals[s], context.zeros[s], read_hand(cell, s, state)) for s in ways}
    heights, before_last = dict(top), dict(top)

    def tick(side: Side, reading: HandReading, before: DescentState) -> DescentState | Outcome[Contact]:
        command, after = descend(reading, before)
        before_last[side], heights[side] = heights[side], command.height
        if isinstance(after, Outcome):  # where it ended is where it stays
            before_last[side] = command.height
        return after

    q0 = state.q + cell.sent.offset(state.q)

    def arms(_: Mapping[Side, DescentState]) -> Array:
        for s, h in heights.items():
            hands[s] = lowered(hands[s], top[s] - h, (before_last[s] - h) / TICK_S)
        return _lowered(q0, ways, {s: hand.position for s, hand in hands.items()})

    return each_hand(cell, states, tick, arms)


def _goal(cell: Workcell, context: Context, side: Side, lowest: float) -> DescentGoal:
    """Contact is expected on top of the stack under the hand; the bottom is what the arm can reach."""
    height = context.grasp_of(side).height
    return DescentGoal(contact=height, bottom=min(max(lowest, -0.008), height), through=height)


def _lowered(q0: Array, ways: Mapping[Side, Descent], depths: Mapping[Side, float]) -> Array:
    q = np.array(q0)
    for side, way in ways.items():
        q[arm_slice(side)] = way.at(depths[side])
    return q


def _press(
    cell: Workcell, context: Context, ways: Mapping[Side, Descent], hands: dict[Side, Follower], pushes: Pushes
) -> Failure | None:
    """From the touch of the first tip to where both tips press, deeper at each further try; a hand goes no deeper
    once a tip is pushed harder than the settings allow.

    Measured from the touch: the table's height is known to a few millimetres only. A hand that leans has one
    open tip lower than the other; the arm gives way to the table as the pads close.
    """
    assert context.motion is not None
    state = cell.ports.arms.state()
    depth0 = {s: _depth_at(cell, s, ways[s], state.q) for s in ways}
    depth1 = {}
    for s in ways:
        lean = 0.5 * PREGRASP_OPENING * abs(np.sin(context.motion.postures[s].pitch))
        depth1[s] = depth0[s] + float(lean) + PRESS + DEEPER * context.count(Adjustment.LOWER)
    last = state.q + cell.sent.offset(state.q)
    n = round(PRESS_S / TICK_S)
    record = telemetry(cell)
    enough: dict[Side, float] = {}
    ticks = Ticks(cell.ports)
    for k in range(1, n + 1):
        left, left_before = faded(k, PRESS_S), faded(k - 1, PRESS_S)
        for s in ways:
            way = depth1[s] - depth0[s]
            depth, speed = depth1[s] - left * way, (left_before - left) * way / TICK_S
            if s in enough:
                depth, speed = enough[s], 0.0
            hands[s] = lowered(hands[s], depth, speed)
        q = _lowered(last, ways, {s: hand.position for s, hand in hands.items()})
        sent = cell.ports.arms.command(q, (q - last) / TICK_S)
        cell.sent.q = last = q
        ticks.wait()
        read = followed(cell.ports, q, sent, cell.execution)
        if read.failure:
            return read.failure
        record(Tick(k * TICK_S, read.unwrap()))
        bad = pushes.look(read.unwrap())
        if bad:
            return bad
        for s, push in pushes.now.items():
            if push > cell.settings.grasp.press_force:
                enough.setdefault(s, comes_to_rest(hands[s]))
    return None


def _depth_at(cell: Workcell, side: Side, way: Descent, q: Array) -> float:
    """How far down its way a hand stands [m], by the measured joints."""
    top = np.zeros(14)
    top[arm_slice(side)] = way.q[0]
    return tool_height(cell, side, top) - tool_height(cell, side, q)


def _close_and_confirm(cell: Workcell, context: Context, settings: GraspSettings) -> Outcome[dict[Side, Held]]:
    state = cell.ports.arms.state()
    states = {s: start_close(settings, zero, read_hand(cell, s, state)) for s, zero in context.zeros.items()}

    def tick(side: Side, reading: HandReading, before):  # type: ignore[no-untyped-def]
        command, after = close(reading, before)
        command_grip(cell, side, command)
        return after

    closed = each_hand(cell, states, tick)
    if closed.failure:
        return Outcome(failure=closed.failure)
    thickness = context.known_garment.material.thickness
    confirmations = {
        s: start_confirm(settings, zero, _expected(context.grasp_of(s), thickness))
        for s, zero in context.zeros.items()
    }
    return each_hand(cell, confirmations, lambda side, r, s: confirm(r, s))


def _expected(grasp: Grasp, thickness: float) -> Expectation:
    """The planned layers; a hand that goes under the whole stack takes what the stack has."""
    whole_stack = grasp.height < (grasp.layers + 0.5) * thickness
    return Expectation(thickness, grasp.layers, or_more=whole_stack)


def _slip_watch(cell: Workcell, context: Context) -> Watch:
    watches = {s: start_slip_watch(cell.grasp, context.zeros[s], held) for s, held in context.held.items()}

    def look(tick: Tick) -> Failure | None:
        for side, watch in watches.items():
            after = watch_slip(read_hand(cell, side, tick.state), watch)
            if isinstance(after, Outcome):
                return after.failure
            watches[side] = after
        return None

    return look


def _photographer(cell: Workcell, context: Context, moments: Array, pictures: list[CameraFrame]) -> Watch:
    """Takes a picture at each moment, for the record only: a camera that fails does not end the fold."""
    due = list(moments)

    def look(tick: Tick) -> Failure | None:
        if due and tick.t >= due[0]:
            try:
                frame = cell.ports.camera.glimpse()
            except DriverError as e:
                if e.kind is FailureKind.STOPPED:
                    raise
                due.pop(0)
                return None
            if frame is not None:
                due.pop(0)
                pictures.append(frame)
                cell.recorder.camera(cell.ports.clock.now(), frame, context.calibration(cell.calibration))
        return None

    return look


def _all_of(*watches: Watch) -> Watch:
    def look(tick: Tick) -> Failure | None:
        for watch in watches:
            failure = watch(tick)
            if failure:
                return failure
        return None

    return look
