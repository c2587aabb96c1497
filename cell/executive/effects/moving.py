"""Effects that move the arms through the air: prepare, approach, retreat, clear, make safe, hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.control.checks import come_to_rest, fresh_state, hold, stopped
from cell.control.motions.hands import each_hand
from cell.control.motions.hold_position import wait
from cell.control.motions.trajectory import stream
from cell.control.path_clock import PathControl
from cell.control.ticks import TICK_S
from cell.hardware.workcell import Workcell
from cell.states.run_context import Result, RunContext
from cell.states.stages import Attempt
from cell.states.transition_table import Event
from robots.errors import DriverError, Failure, FailureKind
from robots.ports import ArmTrajectory, Side
from skills.cloth.pinch import PadGeometry
from skills.grasping.hand_reading import GripCommand
from skills.grasping.stuck_on_finger import check_stuck, start_stuck_check
from skills.motion.moves.free_motion import plan_free_motion
from skills.motion.moves.retreat import Retreat, plan_retreat
from skills.motion.validation.trajectory_check import check_trajectory
from skills.vocabulary import Outcome

__all__ = [
    "approach",
    "clear",
    "hold_still",
    "make_safe",
    "move",
    "pausable",
    "prepare",
    "reenter",
    "retreat",
    "unpausable",
    "with_waiting_time",
]

HEAD_TURN_S = 1.5
OPENING_S = 0.8
SLOW_OPENING_S = 2.0
"""A gripper that still moves may open yet."""
CALIBRATION_S = 12.0
LET_GO = 0.010
"""What the pads hold has fallen out of them when they are so far apart [m]."""
PREGRASP_OPENING = PadGeometry().stroke
"""The pads' opening in a descent [m]."""


def pausable(cell: Workcell) -> PathControl:
    """For motions that the operator may pause or end on their way."""
    return PathControl(cell.commands, cell.robot.protective, cell.limits, cell.tell, cell.note)


def unpausable(cell: Workcell) -> PathControl:
    """For motions that make the cell safe: only the stop ends them."""
    return PathControl(None, cell.robot.protective, cell.limits)


def move(
    cell: Workcell, trajectory: ArmTrajectory, fingertips: bool = False, control: PathControl | None = None
) -> Failure | None:
    """Check a trajectory against where the arms are now, then stream it. control: pausable(cell) when None."""
    state = fresh_state(cell.ports, cell.execution)
    if state.failure:
        return state.failure
    checked = check_trajectory(
        cell.robot, cell.execution_checker, trajectory, state.unwrap().q, cell.limits,
        allow_fingertips=fingertips, start_tolerance=cell.execution.start,
    )  # fmt: skip
    if checked.failure:
        return checked.failure
    return stream(cell.loop, trajectory, cell.hands.recording(), control or pausable(cell)).failure


def prepare(cell: Workcell, context: RunContext) -> Result:
    """Motors on, grippers calibrated and open, head where the camera was calibrated, arms parked."""
    ports = cell.ports
    failure = stopped(ports)
    if failure is None:
        ports.arms.enable()
        ports.head.command_pan(cell.calibration.head_pan)
        for gripper in ports.grippers.values():
            gripper.calibrate()
        _open(cell)
        control = pausable(cell)
        failure = wait(cell.loop, HEAD_TURN_S, cell.hands.recording()) or _calibrated(cell)
        failure = failure or _park(cell, control)
        context = with_waiting_time(context, control)
    return _ended(context, failure)


def reenter(cell: Workcell, context: RunContext, reentry: Event) -> Result:
    """Make an interrupted run's cell ready again: motors on, whatever the hands may hold let go, head turned back,
    arms parked. Grippers that lost their calibration or are in error are calibrated, which also opens them."""
    ports = cell.ports
    failure = stopped(ports)
    if failure is None:
        ports.arms.enable()
        ports.head.command_pan(cell.calibration.head_pan)
        for gripper in ports.grippers.values():
            state = gripper.state()
            if state.in_error or not state.calibrated:
                gripper.calibrate()
        control = pausable(cell)
        failure = _let_go_and_park(cell, control, HEAD_TURN_S)
        context = with_waiting_time(context, control)
    if failure is not None:
        return Result(Event.FAILED, context.with_failure(failure))
    return Result(reentry, context, {"folds_done": len(context.done)})


def approach(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """To above the grasps, the hands that grasp as wide open as the prediction has them."""
    for side in attempt.motion.postures:
        cell.hands.command(side, GripCommand(PREGRASP_OPENING, cell.grasp.release_force))
    control = pausable(cell)
    failure = move(cell, attempt.motion.approach, control=control)
    attempt = replace(attempt, before=context.sight.frame, carried=False)
    begun = replace(context, fold=replace(context.fold, attempt=attempt, grasps=context.fold.grasps + 1))
    return _ended(with_waiting_time(begun, control), failure)


def retreat(cell: Workcell, context: RunContext) -> Result:
    """Straight up from the released garment, see that nothing clings, then park."""
    zeros = context.fold.zeros
    away = _plan_retreat(cell, tuple(zeros))
    if away.failure:
        return _ended(context, away.failure)
    control = pausable(cell)
    failure = move(cell, away.unwrap().retreat, fingertips=True, control=control)
    if failure is None:
        checks = {s: start_stuck_check(cell.grasp, tare) for s, tare in zeros.items()}
        failure = each_hand(cell.loop, cell.hands, checks, lambda side, r, state: check_stuck(r, state)).failure
    failure = failure or move(cell, away.unwrap().park, control=control)
    return _ended(with_waiting_time(context, control), failure)


def clear(cell: Workcell, context: RunContext) -> Result:
    """After a failure near the garment: let go, rise, park."""
    control = pausable(cell)
    failure = _let_go_and_park(cell, control)
    return _ended(with_waiting_time(context, control), failure)


def make_safe(cell: Workcell, context: RunContext) -> Result:
    """Let go and park whatever happened; a driver that refuses ends in FAULT with the arms held."""
    try:
        failure = _let_go_and_park(cell, unpausable(cell))
    except DriverError as e:
        failure = e.failure()
    return _ended(context, failure)


def hold_still(cell: Workcell, context: RunContext) -> Result:
    """Speed zero. A stopped robot holds itself; what else can be told is told to hold."""
    if not cell.ports.stop.state().stopped:
        try:
            hold(cell.ports, cell.execution)
        except DriverError as e:
            return Result(Event.DONE, context, {"kind": e.kind.value, "what": e.what})
    return Result(Event.DONE, context)


def _ended(context: RunContext, failure: Failure | None) -> Result:
    if failure is None:
        return Result(Event.DONE, context)
    return Result(Event.FAILED, context.with_failure(failure))


def _open(cell: Workcell) -> None:
    for side, gripper in cell.ports.grippers.items():
        cell.hands.command(side, GripCommand(gripper.max_opening, cell.grasp.release_force))


def with_waiting_time(context: RunContext, control: PathControl) -> RunContext:
    """What was spent in pauses is not the robot's time."""
    return replace(context, waited_s=context.waited_s + control.waited_s) if control.waited_s else context


def _let_go_and_park(cell: Workcell, control: PathControl, opening_s: float = OPENING_S) -> Failure | None:
    _open(cell)
    failure = wait(cell.loop, opening_s, cell.hands.recording()) or _calibrated(cell)
    if failure is None and _still_closed(cell) and any(g.state().moving for g in cell.ports.grippers.values()):
        failure = wait(cell.loop, SLOW_OPENING_S, cell.hands.recording())
    return failure or _still_closed(cell) or _park(cell, control)


def _calibrated(cell: Workcell) -> Failure | None:
    """Wait for grippers that are still being calibrated: their pads go where they like."""
    deadline = cell.ports.clock.now() + CALIBRATION_S
    while True:
        busy = [side.value for side, g in cell.ports.grippers.items() if not g.state().calibrated]
        if not busy:
            return None
        if cell.ports.clock.now() > deadline:
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {' and the '.join(busy)} gripper is not calibrated after {CALIBRATION_S:.0f} s",
                "see whether it is plugged in and free to move",
            )
        failure = wait(cell.loop, TICK_S)
        if failure:
            return failure


def _still_closed(cell: Workcell) -> Failure | None:
    """A hand that did not open may hold the garment, and would take it along. So may one of which nobody knows."""
    for side, gripper in cell.ports.grippers.items():
        state = gripper.state()
        opening, age = state.opening, cell.ports.clock.now() - state.stamp
        if not (age <= cell.grasp.gripper_stale and np.isfinite(opening)):
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {side.value} gripper has said nothing for {age:.1f} s: it may hold the garment",
                "check its cable, and free the garment by hand",
                {"age_s": age},
            )
        if opening < LET_GO:
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {side.value} gripper does not open ({opening * 1e3:.0f} mm): it may hold the garment",
                "free the garment by hand, then see to the gripper",
                {"opening_m": opening},
            )
    return None


def _park(cell: Workcell, control: PathControl) -> Failure | None:
    """Straight to the parked pose where the way is free, else first straight up."""
    q = cell.ports.arms.state().q
    if np.abs(q - cell.robot.q_park).max() < cell.execution.settled:
        return None
    if cell.checker.contact(q) is None:
        way = plan_free_motion(cell.robot, cell.checker, q, cell.robot.q_park, limits=cell.limits, rng=cell.rng())
        if way.ok:
            return move(cell, way.unwrap(), control=control)
    away = _plan_retreat(cell, tuple(Side))
    if away.failure:
        return away.failure
    risen = move(cell, away.unwrap().retreat, fingertips=True, control=control)
    return risen or move(cell, away.unwrap().park, control=control)


def _plan_retreat(cell: Workcell, sides: tuple[Side, ...]) -> Outcome[Retreat]:
    restless = come_to_rest(cell.ports, cell.execution, cell.last_command)
    state = fresh_state(cell.ports, cell.execution)
    if restless or state.failure:
        return Outcome(failure=restless or state.failure)
    q = state.unwrap().q
    rng = cell.rng()
    # with the margins that are planned with where that can be, else with those that brought the arms here
    for checker in (cell.checker, cell.execution_checker):
        away = plan_retreat(cell.robot, checker, q, sides, limits=cell.limits, rng=rng)
        if away.ok:
            return away
    if sides != tuple(Side):
        return away
    for side in Side:  # a hand that cannot rise stays where it is while the other one does
        one = plan_retreat(cell.robot, cell.execution_checker, q, (side,), limits=cell.limits, rng=rng)
        if one.ok:
            return one
    return Outcome(
        failure=Failure(
            FailureKind.UNREACHABLE, f"no way up and home was found: {away.failure}", "jog the arms by hand"
        )
    )
