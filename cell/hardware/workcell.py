"""The workcell of a run: its ports, models, contents of files, and worker threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.control.checks import ExecutionLimits, stopped
from foldcell.cell.control.hand_record import HandRecord
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motions.hands import Hands
from foldcell.cell.control.set_points import LastCommand, PathRecord
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.model import JointLimits, RobotModel
from foldcell.robots.ports import Ports, Stop
from foldcell.skills.fold_plan.ideal_heights import IdealFoldHeights
from foldcell.skills.garments.garment import Garment
from foldcell.skills.grasping.settings import GraspSettings
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.perception.inspection.result import InspectionSettings
from foldcell.skills.perception.settings import PerceptionSettings
from foldcell.skills.trajectory.trajectory_library import Library
from foldcell.skills.vocabulary import CameraCalibration, FoldStep, GraspTrajectory, Table

T = TypeVar("T")

_POLL_S = 0.02


@dataclass(frozen=True, eq=False)
class Workcell:
    """Everything that a run knows about its cell. expected: the garment named in the request, None for 'auto'."""

    ports: Ports
    settings: CellSettings
    table: Table
    calibration: CameraCalibration
    robot: RobotModel
    checker: CollisionChecker
    execution_checker: CollisionChecker
    """Checks motions immediately before they are sent, with slightly smaller margins than in planning."""
    limits: JointLimits
    execution: ExecutionLimits
    garments: tuple[Garment, ...]
    expected: Garment | None
    grasp: GraspSettings
    perception: PerceptionSettings
    inspection: InspectionSettings
    library: Callable[[], Library]
    keep: Callable[[GraspTrajectory, FoldStep, Garment, Mapping[str, float | int | str]], None]
    """Adds an optimised trajectory to the user's library."""
    ideal_heights: Callable[[Garment], tuple[IdealFoldHeights, ...]]
    """Returns the heights of a garment's ideal folds; empty if they were not computed."""
    recorder: Recorder
    commands: CommandQueue
    workers: ThreadPoolExecutor
    attended: bool
    approve: bool
    tell: Callable[[str], None]
    """Shows a line to the operator."""
    progress: Callable[[int, int, str], None]
    """Shows the progress of a long computation: number of items done, largest number of items, remark."""
    rng: Callable[[], np.random.Generator]
    """Makes a random generator for the motion planner, always with the same seed."""
    note: Callable[[str, Mapping[str, float]], None] = lambda name, values: None
    """Writes an event that occurs within an effect to the journal: name, figures."""
    last_command: LastCommand = field(default_factory=LastCommand)
    """The last set-point sent to the arms."""
    path: PathRecord = field(default_factory=PathRecord)
    """The set-points sent since the arms last stood parked."""
    hand_record: HandRecord = field(default_factory=HandRecord)
    """The record of the hands since they took cloth."""
    watched_stop: Stop | None = None
    """The stop that is polled in real time while a skill computes; None: `ports.stop`. Polling it only ends the
    wait. Whether the run stops is decided by `ports.stop`, which is read once after the wait."""

    laid_by_person: bool = False
    """Whether a person lays the garment in a simulated cell, too. Waiting for a person is no robot time."""

    @property
    def loop(self) -> ControlLoop:
        return ControlLoop(self.ports, self.execution, self.last_command, self.path)

    @property
    def hands(self) -> Hands:
        return Hands(self.ports, self.robot, self.table, self.recorder, self.hand_record)

    def compute(self, charge_s: Callable[[T], float] | float, work: Callable[[], T]) -> T:
        """Run a skill on a worker thread and poll the stop meanwhile. Returns the skill's result.

        charge_s: cell time that the computation takes in a simulated cell [s], a number or a function of the
        skill's result. Raises DriverError(STOPPED) if the stop is triggered meanwhile; the skill's result is then
        discarded.
        """
        began = self.ports.clock.now()
        future = self.workers.submit(work)
        stop = self.watched_stop or self.ports.stop
        while not wait([future], timeout=_POLL_S).done and not stop.state().stopped:
            pass
        failure = stopped(self.ports)
        if failure:
            future.cancel()
            raise DriverError(FailureKind.STOPPED, failure.what, failure.hint)
        result = future.result()
        if self.ports.simulated:
            cost = charge_s(result) if callable(charge_s) else charge_s
            self.ports.clock.sleep_until(began + cost)
        return result
