"""Effects with the garment in the hands: lift it, follow the arc, release it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.cell.control.motion import Tick, Watch
from foldcell.cell.control.motions.hands import commanding, each_hand
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.executive.effects.checked_motion import as_failure, move, pausable, with_waiting_time
from foldcell.cell.executive.effects.recovery.parking import RELEASE_OPENING
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.grasping.confirm import LiftCheck, check_lift
from foldcell.skills.grasping.release import release, start_release
from foldcell.skills.grasping.slip import start_slip_watch, watch_slip
from foldcell.skills.motion.moves.arc import plan_arc
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.vocabulary import CameraCalibration, Outcome


@effect
def lift(cell: Workcell, context: RunContext) -> Result:
    """Lift the garment a little and check that every hand still holds it."""
    fold, q = context.fold, cell.ports.arms.state().q
    if fold.repair is None:  # how the garment lay before a repair is less certain than how it lies after it
        cell.hand_record.begin()
    height = cell.settings.grasp.lift_height
    up = plan_lift(cell.robot, cell.execution_checker, q, tuple(fold.held), height, limits=cell.limits)
    if up.ok:
        context = replace(context, fold=replace(fold, carrying=(up.unwrap(),)))
    control = pausable(cell)
    failure = up.failure or as_failure(lambda: move(cell, up.unwrap(), fingertips=True, control=control))
    context = with_waiting_time(context, control)
    context.require(failure)
    checks = {s: LiftCheck(cell.grasp, fold.biases[s], held) for s, held in fold.held.items()}
    held = context.need(each_hand(cell.loop, cell.hands, checks, lambda side, r, s: check_lift(r, s)))
    return Result(Event.DONE, replace(context, fold=replace(context.fold, held=held)))


@effect
def fold(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """Follow the arc from the hands' measured pose, watch for slip, and take the pictures for the report."""
    arc = context.need(
        plan_arc(
            cell.robot, cell.execution_checker, cell.table, attempt.paths, attempt.motion.postures,
            cell.ports.arms.state().q, limits=cell.limits, tool_speed=attempt.tool_speed, rng=cell.rng(),
        )
    )  # fmt: skip
    trajectory = arc.fold
    lift = context.fold.carrying[:1]  # without the arc of an earlier call, which ended before it moved
    context = replace(context, fold=replace(context.fold, carrying=(*lift, trajectory)))
    pictures: list[CameraFrame] = []
    moments = np.linspace(0.0, trajectory.duration, cell.settings.recorder.key_frames)
    calibration = context.sight.calibration(cell.calibration)
    watch = all_of(slip_watch(cell, context.fold), _photographer(cell, calibration, moments, pictures))
    control = pausable(cell)
    failure = as_failure(lambda: stream(cell.loop, trajectory, cell.hands.recording(watch), control).failure)
    executed = replace(attempt.motion, **vars(arc))  # friction is learned from the executed arc
    attempt = replace(attempt, pictures=tuple(pictures), motion=executed)
    context = with_waiting_time(context.with_attempt(attempt), control)
    context.require(failure)
    # a run that is interrupted from now on is resumed with a look at the completed fold
    context = context.with_attempt(replace(attempt, carried=True))
    return Result(Event.DONE, context, {"duration_s": trajectory.duration})


@effect
def release_garment(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """Open the pads just wide enough to release the garment."""
    context, hands, repair = context.with_attempt(replace(attempt, carried=True)), cell.hands, context.fold.repair
    state = cell.ports.arms.state()
    states = {s: start_release(RELEASE_OPENING, hands.read(s, state)) for s in context.fold.held}
    context.need(each_hand(cell.loop, hands, states, commanding(hands, release)))
    if repair is not None:
        made = (context.fold.index, f"{repair.name}: {repair.in_words()}")
        context = replace(context, repairs=(*context.repairs, made))
    return Result(Event.DONE, replace(context, fold=replace(context.fold, held={})))


def slip_watch(cell: Workcell, fold: FoldContext) -> Watch:
    """Return a watch that fails as soon as one of the hands loses its cloth."""
    watches = {s: start_slip_watch(cell.grasp, fold.biases[s], held) for s, held in fold.held.items()}

    def look(tick: Tick) -> Failure | None:
        for side, watch in watches.items():
            after = watch_slip(cell.hands.read(side, tick.state), watch)
            if isinstance(after, Outcome):
                return after.failure
            watches[side] = after
        return None

    return look


def _photographer(
    cell: Workcell, calibration: CameraCalibration, moments: Array, pictures: list[CameraFrame]
) -> Watch:
    """Take a picture at each of the moments [s]. The pictures are only for the recording and the report. Therefore
    a camera failure does not end the fold, but a stop does."""
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
                cell.recorder.camera(cell.ports.clock.now(), frame, calibration)
        return None

    return look


def all_of(*watches: Watch) -> Watch:
    """Return a watch that fails as soon as one of the watches does."""

    def look(tick: Tick) -> Failure | None:
        for watch in watches:
            failure = watch(tick)
            if failure:
                return failure
        return None

    return look
