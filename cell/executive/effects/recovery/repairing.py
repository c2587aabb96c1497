"""The effect that plans a repair: a half-made fold is completed from where its edge lies, or undone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.planning.fold_planning import tool_speed
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import Result, RunContext
from foldcell.cell.states.stages import Attempt, Plan, Repair
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import CellError, Failure, FailureKind
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import translate_plan
from foldcell.skills.fold_plan.repair import RepairGoal, RepairPlan, plan_repair, ways_to_hold
from foldcell.skills.perception.inspection.diagnosis import corners_in_place
from foldcell.skills.state_estimate.comparison import Fit
from foldcell.skills.trajectory.arcs.paths import fold_duration, lifted, tool_paths
from foldcell.skills.trajectory.arcs.repair_arcs import repair_arcs, turned_paths
from foldcell.skills.trajectory.search.acceptance import acceptance_limit
from foldcell.skills.trajectory.search.objective import dissimilarity
from foldcell.skills.vocabulary import Array, GraspId, GraspTrajectory


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A way to repair the fold, with the shape (n, 3) that it aims at [m]. held: how the hands hold the cloth, in
    words; empty if as in the fold."""

    plan: RepairPlan
    trajectory: GraspTrajectory
    target: Array
    held: str


def choose_repair(cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt) -> Result:
    """Plan how the hands put right the cloth that a fold has moved, from the estimated state of the garment.

    The fold is completed if the garment is then predicted to lie about as well as the fold was planned to leave
    it. Otherwise it is undone. This may follow an earlier plan to complete it: the arms may have found no good
    way, or the cloth may have slipped again. A way after which the garment would lie no nearer to its aim than now
    is not taken. If every way is predicted to miss, the hands are to hold the cloth elsewhere, or one hand alone.
    Of several arcs, the one that is predicted to come nearest to its aim is chosen. Motion planning follows, as
    for a fold.
    """
    fold, thickness = context.fold, plan.garment.thickness_of(context.measured_layer)
    found = believed(fold, attempt)
    if found is None:
        return _failed(context, _impossible("it is not known how the garment lies"))
    (step,) = translate_plan((attempt.step,), found.drift, found.drift_rad, found.about)
    before, now = found.placed(plan.vertices), found.shape.vertices
    folded = found.placed(target_vertices(plan.mesh, attempt.step.lines, plan.garment.material))
    aims = {RepairGoal.COMPLETE: folded, RepairGoal.UNDO: before}
    completed = RepairGoal.COMPLETE in fold.tried
    limits = {
        RepairGoal.COMPLETE: -np.inf if completed else acceptance_limit(plan.mesh.rest, attempt.dissimilarity_m),
        RepairGoal.UNDO: acceptance_limit(plan.mesh.rest),
    }
    ways: list[_Candidate] = []
    refused: Failure | None = None
    for words, held in ways_to_hold(step):
        plans = {
            g: plan_repair(g, plan.mesh, before, now, held, thickness, fold.planned_layer(plan)) for g in aims
        }
        refused = refused or plans[RepairGoal.UNDO].failure
        new = [
            _Candidate(planned.value, _trajectory(cell, plan, controls), aims[goal], words)
            for goal, planned in plans.items() if planned.value is not None
            for controls in repair_arcs(attempt.trajectory.control_points, planned.value, thickness)
        ]  # fmt: skip

        def work(new: Sequence[_Candidate] = tuple(new)) -> list[_Candidate]:
            return [_simulated(cell, plan, way, now) for way in new]

        ways += cell.compute(len(new) * cell.settings.computing.simulation_s, work) if new else []
        if any(way.trajectory.dissimilarity <= limits[way.plan.goal] for way in ways):
            break
    predicted = [way for way in ways if np.isfinite(way.trajectory.dissimilarity)]
    if not ways:
        assert refused is not None
        return _failed(context, refused)
    if not predicted:
        return _failed(context, _impossible("each way brings it no nearer to its aim, or its simulation fails"))
    best = _best(predicted, limits[RepairGoal.COMPLETE])
    repair, motion = Repair(best.plan, best.trajectory, now, best.target, found, attempt), best.plan.step
    record = {
        "goal": best.plan.goal.value,
        "hands": sorted(grasp_id.value for grasp_id in motion.grasps),
        "distance_m": {i.value: float(np.linalg.norm(t[:2] - motion.grasps[i].point))
                       for i, t in motion.targets.items()},
        "dissimilarity_m": best.trajectory.dissimilarity,
        **({"held": best.held} if best.held else {}),
    }  # fmt: skip
    cell.recorder.plan(cell.ports.clock.now(), motion)
    # until a motion is planned, nothing was carried in this repair
    begun = replace(attempt, carried=False)
    fold = replace(fold, repair=repair, attempt=begun, tried=(*fold.tried, best.plan.goal))
    return Result(Event.DONE, replace(context, fold=fold), record)


def believed(fold: FoldContext, attempt: Attempt) -> Fit | None:
    """Return how the garment lies. An estimate that one hand has lost its corner is not believed if the inspection
    has seen all of the moved edge, with both corners in place. The fold then lies about as predicted."""
    if fold.estimate is None:
        return None
    found, seen = fold.estimate.likeliest_shape, attempt.inspection
    how = None if found is None else found.hypothesis.interruption
    contradicted = how is not None and len(how.lost) == 1 and seen is not None and corners_in_place(seen)
    return fold.estimate.as_folded or found if contradicted else found


def _best(ways: Sequence[_Candidate], limit: float) -> _Candidate:
    """Return the best way to complete the fold, if its dissimilarity is at most `limit` [m] or if the fold cannot
    be undone, else the best way to undo it."""
    ranked = sorted(ways, key=lambda way: way.trajectory.dissimilarity)
    completing = [way for way in ranked if way.plan.goal is RepairGoal.COMPLETE]
    undoing = [way for way in ranked if way.plan.goal is RepairGoal.UNDO]
    if completing and (not undoing or completing[0].trajectory.dissimilarity <= limit):
        return completing[0]
    return undoing[0]


def _trajectory(cell: Workcell, plan: Plan, controls: Mapping[GraspId, Array]) -> GraspTrajectory:
    """Return arcs as a trajectory that was not simulated yet."""
    return GraspTrajectory(
        controls, fold_duration(controls, tool_speed(cell.settings, plan.garment)), "repair", np.nan, np.inf, 1
    )


def _simulated(cell: Workcell, plan: Plan, way: _Candidate, now: Array) -> _Candidate:
    """Simulate the repair. Return the candidate with the dissimilarity between its aim and the simulated garment,
    which is infinite if the simulation fails, or if the garment would lie no nearer to the aim than now. now:
    (n, 3) the present garment [m]."""
    height, speed = cell.settings.grasp.lift_height, tool_speed(cell.settings, plan.garment)
    paths = turned_paths(tool_paths(way.trajectory, way.plan.step, speed), way.plan.headings)
    paths = {grasp_id: lifted(path, height) for grasp_id, path in paths.items()}
    try:
        end = predict_fold(
            plan.mesh, now, plan.garment.material, paths, pads=cell.settings.gripper.pads,
            grip_force=cell.grasp.grip_force, patches=way.plan.patches,
        )  # fmt: skip
    except CellError:
        return way
    if np.linalg.norm(end.vertices - way.target) >= np.linalg.norm(now - way.target):
        return way
    error = dissimilarity(way.target, end.vertices, plan.mesh.triangles, plan.mesh.area)
    return replace(way, trajectory=replace(way.trajectory, dissimilarity=error))


def _impossible(why: str) -> Failure:
    return Failure(FailureKind.HALF_FOLDED, f"the fold cannot be repaired: {why}", "lay the garment as it was")


def _failed(context: RunContext, failure: Failure) -> Result:
    """Return the failure. The estimate is removed from the context, because the same estimate would lead to the
    same failure again."""
    fold = replace(context.fold, estimate=None)
    return replace(context, fold=fold).failed(failure)
