"""Perform a trajectory that is checked immediately before it is sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from foldcell.cell.control.checks import SETTLED, fresh_state
from foldcell.cell.control.motion import Watch
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import ArmTrajectory
from foldcell.skills.motion.validation.trajectory_check import check_trajectory


def pausable(cell: Workcell) -> PathControl:
    """Return the control of a motion that the operator may pause or abort."""
    return PathControl(cell.commands, cell.robot.protective, cell.limits, cell.tell, cell.note)


def unpausable(cell: Workcell) -> PathControl:
    """Return the control of a motion that makes the cell safe. Only the stop ends such a motion."""
    return PathControl(None, cell.robot.protective, cell.limits)


def move(
    cell: Workcell,
    trajectory: ArmTrajectory,
    fingertips: bool = False,
    control: PathControl | None = None,
    watch: Watch | None = None,
) -> Failure | None:
    """Check a trajectory that starts at the arms' present posture, then stream it. control: None means
    pausable(cell). watch: is called on every tick, and may end the motion."""
    state = fresh_state(cell.ports, cell.execution)
    if state.failure:
        return state.failure
    checked = check_trajectory(
        cell.robot, cell.execution_checker, trajectory, state.unwrap().q, cell.limits,
        allow_fingertips=fingertips, start_tolerance=cell.execution.start,
    )  # fmt: skip
    if checked.failure:
        return checked.failure
    failure = stream(cell.loop, trajectory, cell.hands.recording(watch), control or pausable(cell)).failure
    if failure is None and np.abs(trajectory.q[-1] - cell.robot.q_park).max() < SETTLED:
        cell.path.forget()
    return failure


def with_waiting_time(context: RunContext, control: PathControl) -> RunContext:
    """Add the time spent in pauses to the context's waiting time, which is not part of the robot time."""
    return replace(context, waited_s=context.waited_s + control.waited_s) if control.waited_s else context


def as_failure(motion: Callable[[], Failure | None]) -> Failure | None:
    """Perform a motion. An error of the driver becomes a failure, so that the effect can return its context: the
    path with cloth in the hands, or the cause of a clearing. A stop is raised as usual."""
    try:
        return motion()
    except DriverError as e:
        if e.kind is FailureKind.STOPPED:
            raise
        return e.failure()
