"""Optimise the folds of a garment's plan one after another, starting from the flat garment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.planning.fold_planning import search_trajectory
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.paths import lifted, tool_paths
from foldcell.skills.trajectory.search.optimise import METHODS, ClothPredictor
from foldcell.skills.vocabulary import FoldStep, GraspId, GraspTrajectory, Outcome, ToolPath

Progress = Callable[[FoldStep, int, int, float], None]
"""Called after each simulation with: the fold, number of simulations done, budget, smallest dissimilarity D so far
[m]."""


@dataclass(frozen=True, eq=False)
class StepOptimisation:
    """Result for one fold. paths: path of each tool from the grasp through the straight lift to the release; empty
    if the optimisation failed. wall_time_s: duration of the optimisation [s]."""

    step: FoldStep
    outcome: Outcome[GraspTrajectory]
    paths: Mapping[GraspId, ToolPath]
    wall_time_s: float


def check_step(garment: Garment, number: int | None) -> None:
    """Check that the garment's plan has a fold of this number, counted from 1; None: all folds. Raises
    ConfigurationError."""
    if number is not None and not 1 <= number <= len(garment.plan):
        raise ConfigurationError(f"{garment.name} has {len(garment.plan)} folds, so no step {number}")


def optimise_plan(
    garment: Garment,
    settings: CellSettings,
    only: int | None = None,
    method: str | None = None,
    budget: int | None = None,
    begin: Callable[[], None] = lambda: None,
    progress: Progress = lambda step, done, budget, best: None,
) -> Iterator[StepOptimisation]:
    """Optimise the folds in order and yield the result of each. If a fold fails, its result is the last one.

    only: number of the only fold to optimise, from 1; the folds before it use their initial arcs. method, budget
    [simulations per fold]: None: the value of the settings. begin: called before each fold.

    Raises ConfigurationError before the first result: for an unknown method, for a number that the plan does not
    have, and for a plan that the flat garment does not allow.
    """
    check_step(garment, only)
    method = method or settings.optimiser.method
    if method not in METHODS:
        raise ConfigurationError(f"there is no method '{method}'", f"it is one of {', '.join(METHODS)}")
    budget = budget or (None if method == "initial" else settings.optimiser.simulations)

    state = garment.flat_state(*garment.poses.middle)
    mesh = predictor_mesh(state, garment)
    vertices = mesh.lay_flat(garment.material.thickness)
    predict = ClothPredictor(pads=settings.gripper.pads)
    planned = plan_folds(state, garment, pads=settings.gripper.pads)
    if planned.failure:
        raise ConfigurationError(f"{garment.name}: {planned.failure.what}", planned.failure.hint)
    steps = planned.unwrap()[:only]
    for step in steps:
        wanted = only in (None, step.index + 1)
        began = time.monotonic()
        begin()
        outcome = search_trajectory(
            settings, garment, step, mesh, vertices, method if wanted else "initial", budget if wanted else None,
            predict=predict, progress=partial(progress, step),
        )  # fmt: skip
        took = time.monotonic() - began
        if outcome.failure:
            yield StepOptimisation(step, outcome, {}, took)
            return
        arcs = tool_paths(outcome.unwrap(), step)
        paths = {i: lifted(path, settings.grasp.lift_height) for i, path in arcs.items()}
        if wanted:
            yield StepOptimisation(step, outcome, paths, took)
        if step is not steps[-1]:
            vertices = predict(mesh, vertices, garment.material, paths)
