"""Shows known shapes of a garment to the executive, and lets it judge them as it judges its own folds.

The world, its camera and its noise are those of a run. The executive's own effects photograph the empty table,
look at the flat garment, recognise it, plan the folds, choose their trajectories and predict their outcome. But
the arms stay parked: instead of making a fold, the garment is put into a given shape. No time passes
afterwards, so that it cannot move. A picture is therefore that of a run, without what the motions leave to
chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from foldcell.cell.config.cell_settings import CellSettings, ComputingConfig, load_settings
from foldcell.cell.executive.effects import EFFECTS
from foldcell.cell.executive.effects.inspecting import judge_fold, next_step
from foldcell.cell.hardware.assembly import assemble
from foldcell.cell.hardware.robot_model import load_robot
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.simulation.ports import ports_of
from foldcell.cell.simulation.settings import SimulationSettings
from foldcell.cell.simulation.world import World
from foldcell.cell.states.commands import CommandQueue
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import Attempt
from foldcell.cell.states.transition_table import Effect
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.depth_averaging import EXPOSURES
from foldcell.robots.errors import CellError
from foldcell.robots.ports import CameraFrame, Ports
from foldcell.skills.perception.inspection.result import Inspection
from foldcell.skills.vocabulary import Array


class StageError(CellError):
    """The executive cannot get as far as a fold: the garment is not recognised, or no motion is found."""


class StillCamera:
    """The world's camera, which takes the picture of several exposures in no time."""

    def __init__(self, world: World) -> None:
        self._world = world

    def capture(self) -> CameraFrame:
        return self._world.glimpse(EXPOSURES)

    def glimpse(self) -> CameraFrame:
        return self._world.glimpse()


class Stage:
    """A garment in front of the camera, and the executive's knowledge of it."""

    def __init__(self, world: World, cell: Workcell) -> None:
        self.world, self.cell, self.context = world, cell, RunContext()

    def recognise(self) -> None:
        """Look at the empty table and the flat garment, and plan the folds."""
        for effect in (Effect.PHOTOGRAPH_TABLE, Effect.AWAIT_GARMENT, Effect.LOOK, Effect.RECOGNISE,
                       Effect.PLAN_FOLDS):  # fmt: skip
            self.context = _perform(effect, self.cell, self.context)

    def predict(self) -> None:
        """Choose the trajectory of the present fold, and predict its outcome. If the arms have no path, the next
        variant of the fold is planned, as in a run."""
        while True:
            try:
                for effect in (Effect.CHOOSE_TRAJECTORY, Effect.PLAN_MOTION):
                    self.context = _perform(effect, self.cell, self.context)
                break
            except StageError:
                plan, fold = self.context.plan, self.context.fold
                tried = fold.count(Adjustment.OTHER_VARIANT)
                if plan is None or tried >= len(plan.garment.plan[fold.index].variants) - 1:
                    raise
                fold = replace(fold, adjustments=(*fold.adjustments, Adjustment.OTHER_VARIANT))
                self.context = _perform(Effect.PLAN_FOLDS, self.cell, replace(self.context, fold=fold))
        attempt = planned_attempt(self.context)
        self.context = self.context.with_attempt(replace(attempt, before=self.context.sight.frame, carried=True))

    def show(self, vertices: Array) -> RunContext:
        """Put the garment to `vertices` (n, 3), in its own frame [m], and look at it. Return the executive's
        knowledge with the picture. The knowledge of the stage stays as it is."""
        garment = self.world.garment
        garment.put(np.column_stack([garment.pose.place(vertices[:, :2]), vertices[:, 2]]))
        return _perform(Effect.LOOK, self.cell, self.context)

    def accept(self, looked: RunContext) -> None:
        """Judge a shape that was shown as the outcome of the present fold, and go on to the next fold."""
        judged, _ = judge_shown(self.cell, looked)
        self.context = next_step(self.cell, judged).context


def judge_shown(cell: Workcell, looked: RunContext) -> tuple[RunContext, Inspection]:
    """Judge the picture of the present fold's outcome as the executive does. Return its knowledge, with the claim
    about the last fold, and the inspection. Raises StageError if nothing can be judged."""
    frame, plan = looked.sight.frame, looked.plan
    if frame is None or plan is None:
        raise StageError("there is no picture, or no plan", "call `recognise` and `show` first")
    judged = judge_fold(cell, looked, plan, planned_attempt(looked), frame)
    if judged.failure:
        raise StageError(judged.failure.what, judged.failure.hint)
    attempt, inspection = judged.unwrap()
    return looked.with_attempt(attempt), inspection


def planned_attempt(context: RunContext) -> Attempt:
    if context.fold.attempt is None:
        raise StageError("no fold was planned", "call `predict` first")
    return context.fold.attempt


def _perform(effect: Effect, cell: Workcell, context: RunContext) -> RunContext:
    context = EFFECTS[effect](cell, context).context
    if context.failure is not None:
        raise StageError(f"{effect}: {context.failure.what}", context.failure.hint)
    return context


def settings_of_stage() -> CellSettings:
    """Return the shipped settings, but computing takes no time on the cell's clock."""
    settings = load_settings()
    free = ComputingConfig(**dict.fromkeys(ComputingConfig.model_fields, 0.0))
    return settings.model_copy(update={"computing": free})


def open_world(name: str, seed: int, render: bool = True) -> World:
    """Open the world of a run with this garment and seed."""
    settings = settings_of_stage()
    simulated = SimulationSettings(
        robot=settings.robot,
        garment=name,
        surface=settings.surface,
        table=settings.drawn_table,
        render=render,
    )
    return World(simulated, seed)


@contextmanager
def open_stage(name: str, seed: int, logs: Path) -> Iterator[Stage]:
    """Open the world and the executive of a run. logs: an empty folder, so that no library of the user counts."""
    world = open_world(name, seed)
    try:
        ports = replace(ports_of(world), camera=StillCamera(world))
        with open_executive(name, ports, logs) as cell:
            yield Stage(world, cell)
    finally:
        world.close()


@contextmanager
def open_executive(name: str, ports: Ports, logs: Path) -> Iterator[Workcell]:
    """Assemble the workcell of a run with these ports."""
    settings = settings_of_stage()
    request = FoldRequest(name, 0, "sim", settings, logs, quiet=True, record=False)
    with ThreadPoolExecutor(1, "skill") as workers:
        yield assemble(
            request, load_robot(settings), ports, Recorder.silent(), CommandQueue(), workers, lambda text: None,
            lambda done, most, remark: None,
        )  # fmt: skip
