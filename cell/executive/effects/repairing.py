"""The effect that plans a repair: a half-made fold is undone, so that it can be made anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cell.executive.effects.planning import tool_speed
from cell.hardware.workcell import Workcell
from cell.states.run_context import Result, RunContext
from cell.states.stages import Attempt, Plan, Repair
from cell.states.transition_table import Event
from robots.errors import CellError, Failure, FailureKind
from skills.cloth.predict import predict_fold
from skills.planning.plan import translate_plan
from skills.planning.undo import Undo, plan_undo
from skills.trajectory.objective import dissimilarity
from skills.trajectory.paths import fold_duration, lifted, tool_paths
from skills.trajectory.return_arcs import return_arcs, turned_paths
from skills.vocabulary import Array, GraspId, GraspTrajectory

__all__ = ["plan_repair"]


def plan_repair(cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt) -> Result:
    """Plan how the cloth that a fold has moved is carried back, from the estimated state of the garment.

    Of several arcs, the one is chosen after which the garment is predicted to lie nearest to its shape before the
    fold. Motion planning follows, as for a fold.
    """
    fold, thickness = context.fold, plan.garment.material.thickness
    found = fold.estimate.best if fold.estimate is not None else None
    if found is None:
        return _failed(context, "it is not known how the garment lies")
    (step,) = translate_plan((attempt.step,), found.drift, found.drift_rad, found.about)
    flat, now = found.placed(plan.vertices), found.shape.vertices
    planned = plan_undo(plan.mesh, flat, now, step, thickness)
    if planned.failure:
        return Result(Event.FAILED, context.with_failure(planned.failure))
    undo, speed = planned.unwrap(), tool_speed(cell, plan.garment)
    arcs = return_arcs(attempt.trajectory.control_points, undo.step, thickness)

    def work() -> list[GraspTrajectory]:
        return [_simulated(cell, plan, undo, controls, now, flat, speed) for controls in arcs]

    candidates = cell.compute(len(arcs) * cell.settings.computing.simulation_s, work)
    best = min(candidates, key=lambda c: c.dissimilarity)
    repair = Repair(undo.step, best, undo.headings, now, flat, attempt)
    record = {
        "hands": sorted(grasp_id.value for grasp_id in undo.step.grasps),
        "distance_m": {i.value: float(np.linalg.norm(t[:2] - undo.step.grasps[i].point))
                       for i, t in undo.step.targets.items()},
        "dissimilarity_m": best.dissimilarity,
    }  # fmt: skip
    cell.recorder.plan(cell.ports.clock.now(), undo.step)
    return Result(Event.DONE, replace(context, fold=replace(fold, repair=repair)), record)


def _simulated(
    cell: Workcell,
    plan: Plan,
    undo: Undo,
    controls: Mapping[GraspId, Array],
    now: Array,
    flat: Array,
    speed: float,
) -> GraspTrajectory:
    """Return arcs as a trajectory, with the dissimilarity between the garment after it and before the fold. A
    simulation that fails has an infinite one."""
    trajectory = GraspTrajectory(controls, fold_duration(controls, speed), "undo", np.nan, np.inf, 1)
    height = cell.settings.grasp.lift_height
    paths = turned_paths(tool_paths(trajectory, undo.step, speed), undo.headings)
    paths = {grasp_id: lifted(path, height) for grasp_id, path in paths.items()}
    try:
        end = predict_fold(
            plan.mesh, now, plan.garment.material, paths, pads=cell.settings.gripper.pads,
            grip_force=cell.grasp.grip_force,
        )  # fmt: skip
    except CellError:
        return trajectory
    error = dissimilarity(flat, end.vertices, plan.mesh.triangles, plan.mesh.area)
    return replace(trajectory, dissimilarity=error)


def _failed(context: RunContext, why: str) -> Result:
    failure = Failure(FailureKind.HALF_FOLDED, f"the fold cannot be undone: {why}", "lay the garment as it was")
    return Result(Event.FAILED, context.with_failure(failure))
