"""Effects that take hold, fold and let go: where the arms and the hands' controllers work together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cell.control.motion import Motion, Tick, Watch
from cell.control.motions.descent import GuardedHand, guarded_descent
from cell.control.motions.hands import commanding, each_hand
from cell.control.motions.lowering import Lowering
from cell.control.motions.press import press_down
from cell.control.motions.pushes import Pushes
from cell.control.motions.trajectory import stream
from cell.executive.effects.moving import PREGRASP_OPENING, move, pausable, waited
from cell.hardware.workcell import Workcell
from cell.states.context import Context, Result
from cell.states.recovery_table import Adjustment
from cell.states.transition_table import Event
from robots.errors import DriverError, Failure, FailureKind
from robots.ports import Array, CameraFrame, JointState, Side
from skills.grasping.close import close, start_close
from skills.grasping.confirm import Expectation, Held, confirm, start_confirm
from skills.grasping.descend import Contact, DescentGoal, start_descent
from skills.grasping.lift import check_lift, start_lift_check
from skills.grasping.release import release, start_release
from skills.grasping.settings import GraspSettings
from skills.grasping.slip import start_slip_watch, watch_slip
from skills.grasping.tare import start_zero, zero
from skills.motion.moves.arc import plan_arc
from skills.motion.moves.lift import plan_lift
from skills.vocabulary import Grasp, Outcome

__all__ = ["fold", "grasp", "lift", "release_garment"]

RELEASE_OPENING = 0.020
"""Wide enough to let go, too narrow to sweep the stack [m]."""
PRESS = 0.001
"""Past the touch, so that the pads close under the cloth [m]."""
DEEPER = 0.002
"""How much lower each further try presses [m]."""
STRONGER = 1.4


def grip_settings(cell: Workcell, context: Context) -> GraspSettings:
    """The settings, with the force that recoveries have raised."""
    return replace(cell.grasp, grip_force=cell.grasp.grip_force * STRONGER ** context.count(Adjustment.STRONGER))


def grasp(cell: Workcell, context: Context) -> Result:
    """Down until the tips touch, press into the stack, close, and feel what is held."""
    assert context.motion is not None
    ways = context.motion.descend
    settings = grip_settings(cell, context)
    tares = {s: start_zero(settings) for s in ways}
    zeros = each_hand(cell.loop, cell.hands, tares, lambda side, r, s: zero(r, s))
    if zeros.failure:
        return Result(Event.FAILED, context.with_failure(zeros.failure))
    context = replace(context, zeros=zeros.unwrap())
    lowering: dict[Side, Lowering] = {}
    contacts = _descend(cell, context, settings, lowering)
    if contacts.failure:
        return Result(Event.FAILED, context.with_failure(contacts.failure))
    pushes = Pushes(cell.hands, cell.grasp, context.zeros)
    failure = _press(cell, context, lowering, pushes)
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
    kept = each_hand(cell.loop, cell.hands, checks, lambda side, r, s: check_lift(r, s))
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
    moved = stream(cell.loop, trajectory, cell.hands.recording(watch), control)
    executed = replace(context.motion, arc=arc.unwrap())  # what is learned from the fold is learned from this way
    context = replace(waited(context, control), pictures=tuple(pictures), motion=executed)
    if moved.failure:
        return Result(Event.FAILED, context.with_failure(moved.failure))
    return Result(Event.DONE, context, {"duration_s": trajectory.duration})


def release_garment(cell: Workcell, context: Context) -> Result:
    """Open just wide enough above the stack."""
    context, hands = replace(context, carried=True), cell.hands
    state = cell.ports.arms.state()
    states = {s: start_release(cell.grasp, RELEASE_OPENING, hands.read(s, state)) for s in context.held}
    opened = each_hand(cell.loop, hands, states, commanding(hands, release))
    if opened.failure:
        return Result(Event.FAILED, context.with_failure(opened.failure))
    return Result(Event.DONE, replace(context, held={}))


def _descend(
    cell: Workcell, context: Context, settings: GraspSettings, lowering: dict[Side, Lowering]
) -> Outcome[dict[Side, Contact]]:
    """lowering: gets each hand's set-point on its way down."""
    assert context.motion is not None
    ways = context.motion.descend

    def begin(start: JointState) -> Motion[dict[Side, Contact]]:
        descending = {}
        for s, way in ways.items():
            lowering[s] = Lowering(way, cell.hands.height(s, start.q))
            goal = _goal(context, s, lowering[s].top - float(way.depth[-1]))
            state = start_descent(settings, goal, context.zeros[s], cell.hands.read(s, start))
            descending[s] = GuardedHand(lowering[s], state)
        return guarded_descent(cell.hands, cell.sent, start, descending)

    return cell.loop.run(begin)


def _goal(context: Context, side: Side, lowest: float) -> DescentGoal:
    """Contact is expected on top of the stack under the hand; the bottom is what the arm can reach."""
    height = context.grasp_of(side).height
    return DescentGoal(contact=height, bottom=min(max(lowest, -0.008), height), through=height)


def _press(cell: Workcell, context: Context, lowering: Mapping[Side, Lowering], pushes: Pushes) -> Failure | None:
    """From the touch of the first tip to where both tips press, deeper at each further try.

    Measured from the touch: the table's height is known to a few millimetres only. A hand that leans has one
    open tip lower than the other; the arm gives way to the table as the pads close.
    """
    assert context.motion is not None
    postures, deeper = context.motion.postures, DEEPER * context.count(Adjustment.LOWER)

    def begin(start: JointState) -> Motion[JointState]:
        strokes = {}
        for s, hand in lowering.items():
            touched = cell.hands.depth(s, hand.way, start.q)
            lean = 0.5 * PREGRASP_OPENING * abs(np.sin(postures[s].pitch))
            strokes[s] = touched, touched + float(lean) + PRESS + deeper
        most = cell.settings.grasp.press_force
        return press_down(cell.hands, cell.sent, start, lowering, strokes, pushes, most)

    return cell.loop.run(begin).failure


def _close_and_confirm(cell: Workcell, context: Context, settings: GraspSettings) -> Outcome[dict[Side, Held]]:
    hands, state = cell.hands, cell.ports.arms.state()
    states = {s: start_close(settings, zero, hands.read(s, state)) for s, zero in context.zeros.items()}
    closed = each_hand(cell.loop, hands, states, commanding(hands, close))
    if closed.failure:
        return Outcome(failure=closed.failure)
    thickness = context.known_garment.material.thickness
    confirmations = {
        s: start_confirm(settings, zero, _expected(context.grasp_of(s), thickness))
        for s, zero in context.zeros.items()
    }
    return each_hand(cell.loop, hands, confirmations, lambda side, r, s: confirm(r, s))


def _expected(grasp: Grasp, thickness: float) -> Expectation:
    """The planned layers; a hand that goes under the whole stack takes what the stack has."""
    whole_stack = grasp.height < (grasp.layers + 0.5) * thickness
    return Expectation(thickness, grasp.layers, or_more=whole_stack)


def _slip_watch(cell: Workcell, context: Context) -> Watch:
    watches = {s: start_slip_watch(cell.grasp, context.zeros[s], held) for s, held in context.held.items()}

    def look(tick: Tick) -> Failure | None:
        for side, watch in watches.items():
            after = watch_slip(cell.hands.read(side, tick.state), watch)
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
