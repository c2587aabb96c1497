"""Assemble the workcell of a run from its settings: models, thresholds, garments, library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from foldcell.cell.config.cell_settings import MotionConfig
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.config.trajectory_library.ideal_heights_file import ideal_heights_of
from foldcell.cell.config.trajectory_library.library_file import (
    add_entry,
    entry_of,
    load_library,
    user_library_path,
)
from foldcell.cell.control.checks import ExecutionLimits
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.planning.fold_planning import motion_rng
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.model import RobotModel
from foldcell.robots.ports import Ports
from foldcell.robots.registry import find_robot
from foldcell.skills.garments.garment import Garment
from foldcell.skills.motion.validation.collision import (
    BODY_MARGIN,
    FINGERTIP_MARGIN,
    TABLE_MARGIN,
    CollisionChecker,
)
from foldcell.skills.trajectory.trajectory_library import Library
from foldcell.skills.vocabulary import FoldStep, GraspTrajectory

SLACK = 0.002
"""Amount by which the collision margins during execution are smaller than those in planning [m]. It allows for
small deviations of the arms from the plan."""


def assemble(
    request: FoldRequest,
    robot: RobotModel,
    ports: Ports,
    recorder: Recorder,
    commands: CommandQueue,
    workers: ThreadPoolExecutor,
    tell: Callable[[str], None],
    progress: Callable[[int, int, str], None],
) -> Workcell:
    """Assemble the workcell of a run. tell: shows a line to the operator; progress: see `Workcell.progress`.

    Raises ConfigurationError for a file that cannot be used.
    """
    settings = request.settings
    expected = None if request.garment == "auto" else load_garment(request.garment, settings.surface)
    shipped = [load_garment(name, settings.surface) for name in list_garments()]
    garments = [g for g in shipped if expected is None or g.name != expected.name]
    library = _RunLibrary(request)
    return Workcell(
        ports=ports,
        settings=settings,
        table=settings.table,
        calibration=camera_calibration(settings),
        robot=robot,
        checker=CollisionChecker(robot, settings.table),
        execution_checker=CollisionChecker(
            robot,
            settings.table,
            body_margin=BODY_MARGIN - SLACK,
            table_margin=TABLE_MARGIN - SLACK,
            fingertip_margin=FINGERTIP_MARGIN - SLACK,
        ),
        limits=robot.limits(settings.motion.accelerations, settings.motion.velocity_scale),
        execution=execution_limits(settings.motion),
        garments=tuple([*([expected] if expected else []), *garments]),
        expected=expected,
        grasp=settings.grasp.settings(
            robot.contact_effort,
            settings.gripper.closed_opening,
            find_robot(settings.robot).gripper.tip_distance(settings.gripper.opening),
        ),
        perception=settings.perception.settings(),
        inspection=settings.inspection.settings(settings.perception),
        library=library.current,
        keep=library.keep,
        ideal_heights=partial(ideal_heights_of, library=user_library_path(request.logs)),
        recorder=recorder,
        commands=commands,
        workers=workers,
        attended=request.approve,
        approve=request.approve,
        tell=tell,
        progress=progress,
        rng=motion_rng,
    )


class _RunLibrary:
    """The trajectory library of a run: its content at the start, and the trajectories that the run adds. Added
    trajectories are also written to the user's file."""

    def __init__(self, request: FoldRequest) -> None:
        self._logs = request.logs
        self._library = load_library(request.logs).library

    def current(self) -> Library:
        return self._library

    def keep(
        self, trajectory: GraspTrajectory, step: FoldStep, garment: Garment, notes: Mapping[str, float | int | str]
    ) -> None:
        initial = float(notes["dissimilarity_initial_m"])
        entry = entry_of(garment, step, trajectory, str(notes["method"]), initial)
        self._library = self._library.with_entry(entry)
        add_entry(self._logs, entry)


def execution_limits(motion: MotionConfig) -> ExecutionLimits:
    return ExecutionLimits(
        start=float(np.deg2rad(motion.start_tolerance_deg)),
        tracking=motion.tracking_tolerance,
        stale_s=motion.max_state_age_s,
        latency_s=motion.latency_s,
    )
