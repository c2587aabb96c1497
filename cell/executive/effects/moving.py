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
"""Additional waiting time for a gripper that still moves [s]."""
CALIBRATION_S = 12.0
LET_GO = 0.010
"""If the pads are at least this far apart, they hold no cloth [m]."""
PREGRASP_OPENING = PadGeometry().stroke
"""Opening of the pads during a descent [m]."""


def pausable(cell: Workcell) -> PathControl:
    """Return the control of a motion that the operator may pause or abort."""
    return PathControl(cell.commands, cell.robot.protective, cell.limits, cell.tell, cell.note)


def unpausable(cell: Workcell) -> PathControl:
    """Return the control of a motion that makes the cell safe. Only the stop ends such a motion."""
    return PathControl(None, cell.robot.protective, cell.limits)


def move(
    cell: Workcell, trajectory: ArmTrajectory, fingertips: bool = False, control: PathControl | None = None
) -> Failure | None:
    """Check a trajectory that starts at the arms' present posture, then stream it. control: None means
    pausable(cell)."""
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
    """Turn the motors on, calibrate and open the grippers, turn the head to its calibrated pan, park the arms."""
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
    """Prepare the cell of an interrupted run: turn the motors on, turn the head back, open the hands, park.

    Grippers in error or without calibration are calibrated, which also opens them.
    """
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
    """Move above the grasps. The grasping hands open as wide as in the prediction."""
    for side in attempt.motion.postures:
        cell.hands.command(side, GripCommand(PREGRASP_OPENING, cell.grasp.release_force))
    control = pausable(cell)
    failure = move(cell, attempt.motion.approach, control=control)
    attempt = replace(attempt, before=context.sight.frame, carried=False)
    context = replace(context, fold=replace(context.fold, attempt=attempt, grasps=context.fold.grasps + 1))
    return _ended(with_waiting_time(context, control), failure)


def retreat(cell: Workcell, context: RunContext) -> Result:
    """Rise straight up from the released garment, check that it does not stick to a finger, then park."""
    biases = context.fold.biases
    planned = _plan_retreat(cell, tuple(biases))
    if planned.failure:
        return _ended(context, planned.failure)
    control = pausable(cell)
    failure = move(cell, planned.unwrap().retreat, fingertips=True, control=control)
    if failure is None:
        checks = {s: start_stuck_check(cell.grasp, bias) for s, bias in biases.items()}
        failure = each_hand(cell.loop, cell.hands, checks, lambda side, r, state: check_stuck(r, state)).failure
    failure = failure or move(cell, planned.unwrap().park, control=control)
    return _ended(with_waiting_time(context, control), failure)


def clear(cell: Workcell, context: RunContext) -> Result:
    """Open the hands, rise and park after a failure near the garment."""
    control = pausable(cell)
    failure = _let_go_and_park(cell, control)
    return _ended(with_waiting_time(context, control), failure)


def make_safe(cell: Workcell, context: RunContext) -> Result:
    """Open the hands and park, whatever happened before. After a driver error the run ends in FAULT with the arms
    held."""
    try:
        failure = _let_go_and_park(cell, unpausable(cell))
    except DriverError as e:
        failure = e.failure()
    return _ended(context, failure)


def hold_still(cell: Workcell, context: RunContext) -> Result:
    """Command the arms to hold. A stopped robot holds by itself and gets no command."""
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
    """Add the time spent in pauses to the context's waiting time, which is not part of the robot time."""
    return replace(context, waited_s=context.waited_s + control.waited_s) if control.waited_s else context


def _let_go_and_park(cell: Workcell, control: PathControl, opening_s: float = OPENING_S) -> Failure | None:
    _open(cell)
    failure = wait(cell.loop, opening_s, cell.hands.recording()) or _calibrated(cell)
    if failure is None and _still_closed(cell) and any(g.state().moving for g in cell.ports.grippers.values()):
        failure = wait(cell.loop, SLOW_OPENING_S, cell.hands.recording())
    return failure or _still_closed(cell) or _park(cell, control)


def _calibrated(cell: Workcell) -> Failure | None:
    """Wait until all grippers are calibrated, because their pads move during a calibration. Returns a failure if
    that takes longer than CALIBRATION_S, or if the run is stopped."""
    deadline = cell.ports.clock.now() + CALIBRATION_S
    while True:
        busy = [side.value for side, g in cell.ports.grippers.items() if not g.state().calibrated]
        if not busy:
            return None
        if cell.ports.clock.now() > deadline:
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {' and the '.join(busy)} gripper is not calibrated after {CALIBRATION_S:.0f} s",
                "check that it is plugged in and free to move",
            )
        failure = wait(cell.loop, TICK_S)
        if failure:
            return failure


def _still_closed(cell: Workcell) -> Failure | None:
    """Return a failure if a hand did not open or its opening is unknown. Such a hand may drag the garment
    along."""
    for side, gripper in cell.ports.grippers.items():
        state = gripper.state()
        opening, age = state.opening, cell.ports.clock.now() - state.stamp
        if not (age <= cell.grasp.gripper_stale and np.isfinite(opening)):
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {side.value} gripper has sent no state for {age:.1f} s: it may hold the garment",
                "check its cable, and free the garment by hand",
                {"age_s": age},
            )
        if opening < LET_GO:
            return Failure(
                FailureKind.GRIPPER_FAULT,
                f"the {side.value} gripper does not open ({opening * 1e3:.0f} mm): it may hold the garment",
                "free the garment by hand, then check the gripper",
                {"opening_m": opening},
            )
    return None


def _park(cell: Workcell, control: PathControl) -> Failure | None:
    """Move to the parked posture: directly if a free motion is found, else after rising straight up."""
    q = cell.ports.arms.state().q
    if np.abs(q - cell.robot.q_park).max() < cell.execution.settled:
        return None
    if cell.checker.contact(q) is None:
        direct = plan_free_motion(
            cell.robot, cell.checker, q, cell.robot.q_park, limits=cell.limits, rng=cell.rng()
        )
        if direct.ok:
            return move(cell, direct.unwrap(), control=control)
    planned = _plan_retreat(cell, tuple(Side))
    if planned.failure:
        return planned.failure
    failure = move(cell, planned.unwrap().retreat, fingertips=True, control=control)
    return failure or move(cell, planned.unwrap().park, control=control)


def _plan_retreat(cell: Workcell, sides: tuple[Side, ...]) -> Outcome[Retreat]:
    failure = come_to_rest(cell.ports, cell.execution, cell.last_command)
    state = fresh_state(cell.ports, cell.execution)
    if failure or state.failure:
        return Outcome(failure=failure or state.failure)
    q = state.unwrap().q
    rng = cell.rng()
    # try the planning margins first, then the smaller margins of execution
    for checker in (cell.checker, cell.execution_checker):
        planned = plan_retreat(cell.robot, checker, q, sides, limits=cell.limits, rng=rng)
        if planned.ok:
            return planned
    if sides != tuple(Side):
        return planned
    for side in Side:  # plan for one hand alone
        one_hand = plan_retreat(cell.robot, cell.execution_checker, q, (side,), limits=cell.limits, rng=rng)
        if one_hand.ok:
            return one_hand
    return Outcome(
        failure=Failure(
            FailureKind.UNREACHABLE,
            f"no retreat to the parked posture was found: {planned.failure}",
            "move the arms by hand",
        )
    )
