"""Effects that plan: fold steps, the trajectory of a step, and the arms' motion with its predicted outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foldcell.cell.control.checks import fresh_state, stopped
from foldcell.cell.executive.effects.editing import edited_state, edited_step, edited_variant
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.planning.fold_planning import (
    PREDICTED_FRAMES,
    plan_arms,
    predict_motion,
    search_rng,
    search_trajectory,
    simulated_paths,
    stored_trajectory,
    tool_speed,
)
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt, Plan, Recognition, Spread
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import DriverError, StorageError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.pinch import Patch
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.folding import target_vertices
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.fold_plan.repair import RepairGoal
from foldcell.skills.garments.garment import Garment
from foldcell.skills.motion.moves.fold import FoldMotion
from foldcell.skills.trajectory.arcs.bezier import evaluate
from foldcell.skills.trajectory.arcs.paths import tool_paths
from foldcell.skills.trajectory.arcs.repair_arcs import turned_paths
from foldcell.skills.trajectory.search.acceptance import acceptance_limit, judge_prediction
from foldcell.skills.trajectory.search.objective import dissimilarity
from foldcell.skills.trajectory.search.optimise import ClothPredictor
from foldcell.skills.trajectory.search.problem import Candidate, Predictor
from foldcell.skills.vocabulary import (
    FoldStep,
    GraspId,
    GraspTrajectory,
    Material,
    Outcome,
    PredictedShape,
    ToolPath,
)

INWARD = 0.012
"""Distance by which each adjustment INWARD moves the grasps towards the fold line [m]."""
PULLING = 0.15
"""Largest speed of the tools in a pull that spreads a garment [m/s]. The cloth then follows by friction alone:
what slides on at this speed comes to rest within 4 mm."""
_ARC = np.linspace(0.0, 1.0, 40)
"""Curve parameters of the points at which the recording draws an arc."""


@dataclass(frozen=True, eq=False)
class _Task:
    """A motion with the cloth: its arcs, its step and its tool paths, and the vertices (n, 3) of the garment
    before it and in its target shape [m]. promised: D for which the motion was chosen [m]; None if any motion with
    an acceptable D will do. simulated: whether the shape before the motion is known, so that the shape after it
    can be predicted. patches: the only cloth that each hand takes in the simulation; None: any."""

    trajectory: GraspTrajectory
    step: FoldStep
    paths: Mapping[GraspId, ToolPath]
    vertices: Array
    target: Array
    promised: float | None = None
    simulated: bool = True
    patches: Mapping[GraspId, Patch] | None = None


@effect
def plan_steps(cell: Workcell, context: RunContext, recognition: Recognition) -> Result:
    """Plan the fold steps, and mesh the observed outline for the predictor.

    After the first fold, the completed steps stay in the plan. The remaining steps are planned again only if the
    present fold must use another variant, or if the operator has changed it.
    """
    fold, previous = context.fold, context.plan if context.fold.index > 0 else None
    if previous is not None and not fold.count(Adjustment.OTHER_VARIANT) and not fold.edits:
        return Result(Event.DONE, context)
    completed = previous.steps[: fold.index] if previous else ()
    garment = previous.garment if previous else _named_garment(cell, recognition)
    flat = previous.flat if previous else edited_state(recognition.perception.state, fold.edits)
    variants = _variants(fold, completed, garment)
    planned = context.need(plan_folds(flat, garment, variants, pads=cell.settings.gripper.pads))
    cell.ports.clock.sleep_until(cell.ports.clock.now() + cell.settings.computing.planning_s)
    present, *later = planned[fold.index :]
    steps = (*completed, edited_step(present, fold.edits), *later)
    if previous:
        plan = replace(previous, steps=steps)
    else:
        mesh = predictor_mesh(flat, garment)
        plan = Plan(garment, garment, flat, steps, mesh, mesh.lay_flat(garment.material.thickness))
    context = replace(context, plan=plan, fold=replace(fold, trajectory=None, attempt=None))
    record = {
        "steps": [s.name for s in steps],
        "ways": [s.variant for s in steps],
        "vertices": len(plan.mesh.rest),
    }
    return Result(Event.DONE, context, record)


def _variants(fold: FoldContext, completed: Sequence[FoldStep], garment: Garment) -> dict[str, str]:
    """Return step name -> variant name for the completed folds and the present fold."""
    step = garment.plan[fold.index]
    chosen = step.variants[fold.count(Adjustment.OTHER_VARIANT) % len(step.variants)].name
    return {**{s.name: s.variant for s in completed}, step.name: edited_variant(fold.edits) or chosen}


@effect
def choose_trajectory(cell: Workcell, context: RunContext, plan: Plan) -> Result:
    """Choose the step's arcs. The library's arcs are used if their simulated fold reaches the dissimilarity that
    is stored with them. Otherwise the arcs are optimised.

    A recovery can change this rule. After OPTIMISE, the library's arcs are only the start of an
    optimisation. After PLAIN_ARC, the initial arcs are used without any optimisation.
    """
    fold, garment, nominal, settings = context.fold, plan.garment, plan.nominal, cell.settings.optimiser
    step = plan.steps[fold.index]
    cell.recorder.plan(cell.ports.clock.now(), step)
    plain = fold.count(Adjustment.PLAIN_ARC) > 0
    method = "initial" if plain else settings.method
    found = _look_up(cell, garment, step) if settings.use_library and not plain else None
    if found is not None:
        cell.ports.clock.sleep_until(cell.ports.clock.now() + cell.settings.computing.library_s)
    trusted = found is not None and not fold.count(Adjustment.OPTIMISE)
    if found is None and settings.use_library and not plain:  # after learning, start from the file's material
        found = _look_up(cell, nominal, step)
    outcome = _optimise(cell, plan, step, method, found, trusted)
    # a stop invalidates the trajectory
    context.require(stopped(cell.ports) or outcome.failure, dict(outcome.notes))
    trajectory = outcome.unwrap()
    record = {**_described(trajectory), **outcome.notes}
    optimised = trajectory.source == "optimised" and method != "initial"  # initial arcs are not stored
    moved = any(edit.grasps or edit.keypoints for edit in fold.edits)  # an arc for these grasps alone
    if optimised and garment.material == nominal.material and not moved:
        try:
            cell.keep(trajectory, step, garment, outcome.notes)
        except StorageError as e:  # the fold continues; the next run optimises again
            cell.tell(f"the trajectory was not added to the library: {e.what}")
            record["not_kept"] = e.what
    return Result(Event.DONE, replace(context, fold=replace(fold, trajectory=trajectory)), record)


def _optimise(
    cell: Workcell, plan: Plan, step: FoldStep, method: str, found: GraspTrajectory | None, trusted: bool
) -> Outcome[GraspTrajectory]:
    """Optimise the step, starting from the arcs `found` in the library. trusted: return these arcs unchanged if
    they reach their stored dissimilarity in this simulation."""
    garment, settings = plan.garment, cell.settings.optimiser
    now, each = cell.ports.clock.now(), cell.settings.computing.simulation_s

    def progress(done: int, budget: int, best: float) -> None:
        cell.progress(done, budget, f"simulations at most, best D {best * 1e3:.1f} mm")

    def watch(done: int, candidate: Candidate, best: Candidate) -> None:
        arcs = {grasp_id: evaluate(c, _ARC) for grasp_id, c in candidate.controls.items()}
        values, best_values = ((c.dissimilarity, c.cost) for c in (candidate, best))
        cell.recorder.candidate(now + done * each, done, arcs, values, best_values)

    return cell.compute(
        lambda outcome: float(outcome.notes.get("simulations", 1)) * each,
        lambda: search_trajectory(
            cell.settings, garment, step, plan.mesh, plan.vertices, method,
            None if method == "initial" else settings.simulations, found, trusted,
            _until_stopped(cell), progress, watch,
        ),
    )  # fmt: skip


def _until_stopped(cell: Workcell) -> Predictor:
    """The cloth simulation. It raises DriverError after a stop, so that the search ends soon."""
    simulate = ClothPredictor(pads=cell.settings.gripper.pads)

    def predict(mesh: Any, positions: Array, material: Material, paths: Mapping[GraspId, ToolPath], /) -> Array:
        failure = stopped(cell.ports)
        if failure:
            raise DriverError(failure.kind, failure.what, failure.hint)
        return simulate(mesh, positions, material, paths)

    return predict


@effect
def plan_motion(cell: Workcell, context: RunContext, plan: Plan, trajectory: GraspTrajectory) -> Result:
    """Plan both arms' motion for the step, and predict the garment's shape after it."""
    fold, speed = context.fold, tool_speed(cell.settings, plan.garment)
    speed = min(speed, PULLING) if isinstance(fold.repair, Spread) else speed
    task = _task(fold, plan, trajectory, speed)
    step, paths = task.step, task.paths
    q_now = context.need(fresh_state(cell.ports, cell.execution)).q
    searches = fold.count(Adjustment.OTHER_SEARCH)
    avoid = fold.avoided if searches else ()
    planned = cell.compute(
        cell.settings.computing.motion_s,
        lambda: plan_arms(
            cell.settings, cell.robot, cell.checker, cell.limits, plan.garment, step, paths, q_now,
            search_rng(cell.rng(), searches), avoid, fold.count(Adjustment.UPRIGHT) > 0, fold.planned_layer(plan),
        ),
    )  # fmt: skip
    motion = context.need(planned)
    cell.recorder.arcs(cell.ports.clock.now(), {s: p.position for s, p in motion.tool_paths.items()})
    after, keyframes, error = _predicted(cell, plan, task, motion)
    predicted = PredictedShape(after, plan.mesh.triangles, plan.mesh.rest)
    attempt = Attempt(task.trajectory, step, paths, speed, motion, predicted, error, keyframes)
    fold = replace(fold, attempt=attempt, avoided=(*fold.avoided, motion.postures), estimate=None)
    context = replace(context, fold=fold)
    cell.recorder.predicted(cell.ports.clock.now(), predicted)
    record = {
        "postures": {s.value: {"path": p.path.value, "turned": p.turned, "pitch_rad": p.pitch, "roll_rad": p.roll}
                     for s, p in motion.postures.items()},
        "fold_s": motion.fold.duration,
        "search": dict(planned.notes),
    }  # fmt: skip
    if task.simulated:
        record["dissimilarity_m"] = error
        limit = acceptance_limit(plan.mesh.rest, task.promised)
        context.require(judge_prediction(step.name, error, limit), record)
    return Result(Event.APPROVAL_NEEDED if cell.approve else Event.DONE, context, record)


def _predicted(cell: Workcell, plan: Plan, task: _Task, motion: FoldMotion) -> tuple[Array, Array, float]:
    """Return the vertices (n, 3) after the motion, the vertices (k, n, 3) at moments during the motion, and D from
    the target [m]. If the shape before the motion is unknown, return the target vertices, no moments, and NaN."""
    if not task.simulated:
        return task.target, np.zeros((0, *task.target.shape)), np.nan
    prediction = cell.compute(
        cell.settings.computing.simulation_s,
        lambda: predict_motion(
            cell.settings, plan.garment, plan.mesh, task.vertices, simulated_paths(cell.settings, motion),
            PREDICTED_FRAMES, task.patches,
        ),
    )  # fmt: skip
    error = dissimilarity(task.target, prediction.vertices, plan.mesh.triangles, plan.mesh.area)
    return prediction.vertices, prediction.keyframes, error


def _named_garment(cell: Workcell, recognition: Recognition) -> Garment:
    """Return the garment that the request names, else the recognised garment, as its file describes it."""
    if cell.expected is not None:
        return cell.expected
    return next(g for g in cell.garments if g.name == recognition.perception.garment)


def _look_up(cell: Workcell, garment: Garment, step: FoldStep) -> GraspTrajectory | None:
    return stored_trajectory(cell.settings, cell.library(), garment, step)


def _described(trajectory: GraspTrajectory) -> dict[str, object]:
    return {
        "source": trajectory.source,
        "dissimilarity_m": trajectory.dissimilarity,
        "simulations": trajectory.simulations,
        "control_points_m": {s.value: np.round(c, 4).tolist() for s, c in trajectory.control_points.items()},
    }


def _inwards(trajectory: GraspTrajectory, step: FoldStep, inset: float) -> tuple[GraspTrajectory, FoldStep]:
    """Return the trajectory and the step with every grasp and every target moved `inset` [m] towards the fold
    line."""
    if inset == 0.0:
        return trajectory, step
    shift = inset * step.line.normal
    grasps = {s: replace(g, point=frozen(g.point - shift)) for s, g in step.grasps.items()}
    targets = {s: frozen(t + np.append(shift, 0.0)) for s, t in step.targets.items()}
    controls = {}
    for grasp_id, c in trajectory.control_points.items():
        share = np.linspace(-1.0, 1.0, len(c))[:, None]
        controls[grasp_id] = frozen(c + share * np.append(shift, 0.0))
    return replace(trajectory, control_points=controls), replace(step, grasps=grasps, targets=targets)


def _task(fold: FoldContext, plan: Plan, trajectory: GraspTrajectory, speed: float) -> _Task:
    """Return the task of the motion: the fold, its repair, or a pull. The grasps of a fold are moved as recoveries
    have demanded."""
    repair = fold.repair
    if isinstance(repair, Spread):
        paths = tool_paths(repair.trajectory, repair.step, speed)
        return _Task(repair.trajectory, repair.step, paths, repair.aim, repair.aim, simulated=False)
    if repair is not None:
        step, arcs = repair.plan.step, repair.trajectory
        paths = turned_paths(tool_paths(arcs, step, speed), repair.plan.headings)
        completing = repair.plan.goal is RepairGoal.COMPLETE  # undone cloth is looked at and folded anew
        promised = arcs.dissimilarity if completing else None
        return _Task(arcs, step, paths, repair.vertices, repair.target, promised, patches=repair.plan.patches)
    inset = INWARD * fold.count(Adjustment.INWARD)
    inset_trajectory, step = _inwards(trajectory, plan.steps[fold.index], inset)
    target = target_vertices(plan.mesh, step.lines, plan.garment.material)
    return _Task(trajectory, step, tool_paths(inset_trajectory, step, speed), plan.vertices, target)
