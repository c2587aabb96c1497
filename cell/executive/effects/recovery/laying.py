"""The effect that lays down the cloth in the hands when a fold has to end: back where it was taken, or on at its
target (cell/states/recovery_table.py)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.rest import await_rest
from foldcell.cell.executive.effects.checked_motion import (
    as_failure,
    move,
    pausable,
    unpausable,
    with_waiting_time,
)
from foldcell.cell.executive.effects.recovery.parking import OPENING_S, RELEASE_OPENING, still_closed
from foldcell.cell.executive.effects.recovery.ways_out import LAYING, Course, lead_out, plan_rise
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.recovery_table import Laying, choose_laying
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.stages import Attempt
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.grasping.hand_reading import GripCommand
from foldcell.skills.grasping.release import RELEASE_FORCE
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.motion.moves.retrace import share_done

_ENDINGS = {FailureKind.ABORTED: Event.GIVE_UP, FailureKind.SKILL_CRASHED: Event.CRASH}
"""Failures after which the run ends when the cloth is laid down, and the event that ends it."""


def lay_back(cell: Workcell, context: RunContext, attempt: Attempt) -> Result:
    """Lead the hands along the path on which they carried the cloth, backwards or on to the target, release the
    cloth there, and rise.

    The ways out state how often this is tried. Without a path the hands open where they are. If the operator ended
    the run, the event is GIVE_UP; after a bug of the program it is CRASH; otherwise DONE. The recovery is chosen
    for the failure that led here.
    """
    cause, fold, control = context.cause or context.failure, context.fold, pausable(cell)
    assert cause is not None
    ending = _ENDINGS.get(cause.kind)
    failure = await_rest(cell.ports, cell.execution, note=cell.hands.note)
    path, q = carried_path(fold.carrying), cell.ports.arms.state().q
    done = progress(fold.carrying, q)
    holding = still_holding(cell, fold, cause)
    laying = choose_laying(cause.kind, done, tuple(fold.held), holding)
    record: dict[str, object] = {
        "laying": laying.value, "progress": round(done, 3), "holding": sorted(side.value for side in holding)
    }  # fmt: skip
    if failure is None and laying is not Laying.RELEASE and len(path):
        course = Course(path if laying is Laying.ONWARD else path[::-1], attempt.tool_speed)
        failure = as_failure(lambda: lead_out(cell, LAYING, control, course))
    if failure is None:
        failure = as_failure(lambda: _release_and_rise(cell, tuple(fold.held)))
        if laying is Laying.ONWARD and failure is None:
            context = context.with_attempt(replace(attempt, carried=True, interrupted=True))
    context = replace(with_waiting_time(context, control), cause=cause)
    if failure is None:
        return Result(ending or Event.DONE, replace(context, failure=cause), record)
    if ending is not None and failure.kind is not FailureKind.STOPPED:
        record["unfinished"] = str(failure)
        return Result(ending, replace(context, failure=cause), record)
    return Result(Event.FAILED, replace(context, failure=failure), record)


def carried_path(carrying: tuple[ArmTrajectory, ...]) -> Array:
    """Return the joints (n, joints) along the trajectories on which the hands carried the cloth; (0, 0) if
    none."""
    return np.vstack([trajectory.q for trajectory in carrying]) if carrying else np.zeros((0, 0))


def progress(carrying: tuple[ArmTrajectory, ...], q: Array) -> float:
    """Return the share of lift and arc that the hands have covered when the joints are at q (joints,). It is 0
    during the lift, because the arc is not known then."""
    return share_done(carried_path(carrying), q) if len(carrying) > 1 else 0.0


def still_holding(cell: Workcell, fold: FoldContext, cause: Failure) -> frozenset[Side]:
    """Return the hands that still hold the cloth that they took. A hand without readings counts as holding."""
    slipped = cause.values.get("side") if cause.kind is FailureKind.SLIPPED else None
    openings = {side: cell.ports.grippers[side].state().opening for side in fold.held}
    return frozenset(
        side
        for side, held in fold.held.items()
        if side != slipped and not _closed_further(openings[side], held.opening, cell.grasp)
    )


def _closed_further(opening: float, confirmed: float, settings: GraspSettings) -> bool:
    """Whether pads that held cloth at the opening `confirmed` have closed so far that the cloth is gone [m]."""
    empty = settings.empty_opening
    return bool(opening - empty < settings.slip_opening_fraction * (confirmed - empty))


def _release_and_rise(cell: Workcell, sides: tuple[Side, ...]) -> Failure | None:
    """Open the hands just wide enough to release the cloth, and lift them straight up."""
    for side in sides:
        cell.hands.command(side, GripCommand(RELEASE_OPENING, RELEASE_FORCE))
    failure = wait(cell.loop, OPENING_S, cell.hands.recording()) or still_closed(cell)
    if failure:
        return failure
    up = plan_rise(cell, sides)
    return up.failure or move(cell, up.unwrap().retreat, fingertips=True, control=unpausable(cell))
