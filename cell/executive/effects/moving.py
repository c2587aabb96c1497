"""Effects that move the arms through the air: prepare, approach, retreat, clear, make safe, hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from foldcell.cell.control.checks import hold, stopped
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.rest import await_rest, stand_by
from foldcell.cell.executive.effects.checked_motion import (
    as_failure,
    move,
    pausable,
    unpausable,
    with_waiting_time,
)
from foldcell.cell.executive.effects.recovery.freeing import leave_freely
from foldcell.cell.executive.effects.recovery.parking import (
    calibrated,
    let_go_and_park,
    open_hands,
    park,
    recalibrate_parked,
)
from foldcell.cell.executive.effects.recovery.ways_out import CLEARING_DWELL_S, PREPARING_DWELLS_S, plan_rise
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.recovery_table import transient
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.skills.grasping.hand_reading import GripCommand
from foldcell.skills.grasping.release import RELEASE_FORCE

HEAD_TURN_S = 1.5
QUICK_STOP_S = 0.1
"""Time in which hands that leave the garment come to rest, if the joints can [s]. Until they rest, they drag cloth
that hangs on a finger."""
BRAKING_S = 1.5
"""Longest wait for arms that were stopped or commanded to hold [s]. They need at most 0.3 s."""


def prepare(cell: Workcell, context: RunContext) -> Result:
    """Turn the motors on, calibrate and open the grippers, turn the head to its calibrated pan, park the arms. A
    transient failure is tried again."""
    control = pausable(cell)

    def begin() -> Failure | None:
        cell.ports.head.command_pan(cell.calibration.head_pan)
        for gripper in cell.ports.grippers.values():
            gripper.calibrate()
        open_hands(cell)
        return wait(cell.loop, HEAD_TURN_S, cell.hands.recording())

    failure = _enable(cell) or _persistent(cell, begin) or calibrated(cell)
    failure = failure or _persistent(cell, lambda: park(cell, control))
    return _ended(with_waiting_time(context, control), failure)


@effect
def reenter(cell: Workcell, context: RunContext, reentry: Event) -> Result:
    """Prepare the cell of an interrupted run: turn the motors on, turn the head back, open the hands, park. A
    transient failure is tried again."""
    control = pausable(cell)

    def work() -> Failure | None:
        cell.ports.head.command_pan(cell.calibration.head_pan)
        return let_go_and_park(cell, control, HEAD_TURN_S)

    failure = _enable(cell) or _persistent(cell, work)
    context = with_waiting_time(context, control)
    context.require(failure)
    return Result(reentry, context, {"folds_done": len(context.done)})


def _enable(cell: Workcell) -> Failure | None:
    """Turn the motors on, if the cell is not stopped. A failure after this does not turn them on again."""
    failure = stopped(cell.ports)
    if failure is None:
        cell.ports.arms.enable()
    return failure


def _persistent(cell: Workcell, work: Callable[[], Failure | None]) -> Failure | None:
    """Do the work. After a transient failure, wait until the arms rest, and do it again: once after each dwell of
    the table."""
    failure = as_failure(work)
    for dwell in PREPARING_DWELLS_S:
        if failure is None or not transient(failure.kind):
            break
        cell.tell(f"{failure.what}: the cell tries again in {dwell:.0f} s")
        stand_by(cell.ports, dwell)
        failure = as_failure(lambda: await_rest(cell.ports, cell.execution) or work())
    return failure


def approach(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """Move above the grasps. The grasping hands open as wide as in the prediction."""
    for side in attempt.motion.postures:
        cell.hands.command(side, GripCommand(cell.settings.gripper.opening, RELEASE_FORCE))
    cell.hand_record.forget()
    control = pausable(cell)
    failure = move(cell, attempt.motion.approach, control=control)
    attempt = replace(attempt, before=context.sight.frame, carried=False, interrupted=False)
    fold = replace(context.fold, attempt=attempt, grasps=context.fold.grasps + 1, carrying=())
    context = replace(context, fold=fold)
    return _ended(with_waiting_time(context, control), failure)


@effect
def retreat(cell: Workcell, context: RunContext) -> Result:
    """Rise straight up from the released garment, free it if it clings to a finger, then park. A gripper that has
    misread the distance of its empty pads is calibrated, and what it measured of the layers is forgotten."""
    biases = context.fold.biases
    way = context.need(plan_rise(cell, tuple(biases)))
    control = replace(pausable(cell), stop_s=QUICK_STOP_S)
    left = leave_freely(cell, way, biases, _thinnest_layer(context), control)
    cell.hand_record.end()
    context = with_waiting_time(context, control)
    leaving, attempt = context.need(left), context.fold.attempt
    record: dict[str, object] = {"cloth_on_finger": leaving.felt} if leaving.felt else {}
    if leaving.felt and attempt is not None:
        context = context.with_attempt(replace(attempt, interrupted=True))
    if leaving.off_zero:
        record["calibrated"] = [side.value for side in leaving.off_zero]
        context.require(recalibrate_parked(cell, leaving.off_zero), record)
        context = replace(context, fold=replace(context.fold, layer_thickness=None))
    return Result(Event.DONE, context, record)


def _thinnest_layer(context: RunContext) -> float:
    """Return the smallest thickness that a layer may have between the pads [m]: as stated, or as measured."""
    stated = context.plan.garment.material.thickness if context.plan else None
    return min((t for t in (stated, context.fold.layer_thickness) if t is not None), default=0.0)


def clear(cell: Workcell, context: RunContext) -> Result:
    """Let the arms come to rest, open the hands and park, after a failure near the garment.

    The recovery is chosen for the failure that led here, even if the clearing fails.
    """
    control, cause = pausable(cell), context.cause or context.failure
    failure = as_failure(
        lambda: await_rest(cell.ports, cell.execution, note=cell.hands.note) or let_go_and_park(cell, control)
    )
    context = with_waiting_time(context, control)
    if failure is None:
        return Result(Event.DONE, replace(context, failure=cause, cause=None))
    return Result(Event.FAILED, replace(context, failure=failure, cause=cause))


def clear_again(cell: Workcell, context: RunContext) -> Result:
    """Clear once more, after a dwell in which a transient may pass."""
    stand_by(cell.ports, CLEARING_DWELL_S)
    return clear(cell, context)


def make_safe(cell: Workcell, context: RunContext) -> Result:
    """Let the arms come to rest, open the hands and park, whatever happened before. After a driver error the run
    ends in FAULT with the arms held."""
    try:
        await_rest(cell.ports, cell.execution)  # the hands open in any case
        failure = let_go_and_park(cell, unpausable(cell))
    except DriverError as e:
        failure = e.failure()
    return _ended(context, failure)


def hold_still(cell: Workcell, context: RunContext) -> Result:
    """Command the arms to hold, and wait until they rest, so that nothing moves after the end of a run. A stopped
    robot brakes and holds by itself and gets no command."""
    try:
        if not cell.ports.stop.state().stopped:
            hold(cell.ports, cell.execution)
        unrest = await_rest(cell.ports, cell.execution, BRAKING_S)
    except DriverError as e:
        return Result(Event.DONE, context, {"kind": e.kind.value, "what": e.what})
    if unrest is None or unrest.kind is FailureKind.STOPPED:
        return Result(Event.DONE, context)
    return Result(Event.DONE, context, {"kind": unrest.kind.value, "what": unrest.what})


def _ended(context: RunContext, failure: Failure | None) -> Result:
    return Result(Event.DONE, context) if failure is None else context.failed(failure)
