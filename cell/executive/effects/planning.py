"""Effects that think: fold steps, the trajectory of a step, and the arms' motion with its predicted outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cell.control.checks import stopped
from cell.hardware.workcell import Workcell
from cell.states.context import Context, Result
from cell.states.recovery_table import Adjustment
from cell.states.transition_table import Event
from robots.errors import DriverError, StorageError
from robots.ports import Array, frozen
from skills.cloth.mesh import mesh_from_contour
from skills.cloth.predict import FoldPrediction, predict_fold
from skills.garments.garment import Garment
from skills.motion.moves.fold import FoldMotion, plan_fold_motion
from skills.planning.folding import target_vertices
from skills.planning.plan import plan_folds
from skills.trajectory.acceptance import acceptance_limit, judge_prediction
from skills.trajectory.bezier import evaluate
from skills.trajectory.library import lookup, trajectory_from
from skills.trajectory.objective import dissimilarity
from skills.trajectory.optimise import ClothPredictor, optimise_fold
from skills.trajectory.paths import after_lift, tool_paths
from skills.trajectory.problem import Candidate, Predictor
from skills.vocabulary import FoldStep, GraspId, GraspTrajectory, Material, Outcome, PredictedShape, ToolPath

__all__ = ["choose_trajectory", "named_garment", "plan_motion", "plan_steps", "simulated_paths"]

INWARD = 0.012
"""How much further inside each further try takes hold [m]."""
KEY_FRAMES = 6
_ARC = np.linspace(0.0, 1.0, 40)
"""Where on a curve the view's points lie."""


def plan_steps(cell: Workcell, context: Context) -> Result:
    """The fold steps, and the predictor's own mesh of what was seen. After the first fold what was made stands; so
    does the rest of the plan, unless the fold at hand is to be made in another way."""
    first = context.index == 0
    if not (first or context.count(Adjustment.OTHER_VARIANT)):
        return Result(Event.DONE, context)
    assert context.perception is not None
    garment = named_garment(cell, context) if first else context.known_garment
    flat = context.perception.state if first else context.flat
    assert flat is not None
    planned = plan_folds(flat, garment, _ways(context, garment))
    if planned.failure:
        return Result(Event.FAILED, context.with_failure(planned.failure))
    cell.ports.clock.sleep_until(cell.ports.clock.now() + cell.settings.computing.planning_s)
    steps = (*context.steps[: context.index], *planned.unwrap()[context.index :])
    context = replace(context, steps=steps, flat=flat, garment=garment, trajectory=None)
    if first:
        mesh = mesh_from_contour(flat.contour, garment.mesh_edge_m, garment.layers)
        context = replace(context, mesh=mesh, vertices=mesh.lay_flat(garment.material.thickness))
    assert context.mesh is not None
    record = {
        "steps": [s.name for s in steps],
        "ways": [s.variant for s in steps],
        "vertices": len(context.mesh.rest),
    }
    return Result(Event.DONE, context, record)


def _ways(context: Context, garment: Garment) -> dict[str, str]:
    """How the folds so far were made, and the one at hand shall be: step name -> name of the plan's way."""
    step = garment.plan[context.index]
    chosen = step.variants[context.count(Adjustment.OTHER_VARIANT) % len(step.variants)]
    return {**{s.name: s.variant for s in context.steps[: context.index]}, step.name: chosen.name}


def choose_trajectory(cell: Workcell, context: Context) -> Result:
    """The step's arcs: those of the library where they keep their promise, or else the best that is found.

    Where a recovery asks for it the library's are only where the search begins, or nothing is searched at all.
    """
    garment, step = context.known_garment, context.step
    settings = cell.settings.optimiser
    cell.recorder.plan(cell.ports.clock.now(), step)
    plain = context.count(Adjustment.PLAIN_ARC) > 0
    method = "initial" if plain else settings.method
    found = _look_up(cell, garment, step) if settings.use_library and not plain else None
    if found is not None:
        cell.ports.clock.sleep_until(cell.ports.clock.now() + cell.settings.computing.library_s)
    trusted = found is not None and not context.count(Adjustment.OPTIMISE)
    nominal = named_garment(cell, context)
    if found is None and settings.use_library and not plain:  # of a fabric that turned out otherwise: a beginning
        found = _look_up(cell, nominal, step)
    outcome = _optimise(cell, context, method, found, trusted)
    failure = stopped(cell.ports) or outcome.failure  # what a stop has cut short is no trajectory to keep
    if failure:
        return Result(Event.FAILED, context.with_failure(failure), dict(outcome.notes))
    trajectory = outcome.unwrap()
    record = {**_described(trajectory), **outcome.notes}
    searched = trajectory.source == "optimised" and method != "initial"  # a first guess promises nothing
    if searched and garment.material == nominal.material:
        try:
            cell.keep(trajectory, step, garment, outcome.notes)
        except StorageError as e:  # the fold can be made all the same; it is searched for again next time
            cell.tell(f"the trajectory is not kept: {e.what}")
            record["not_kept"] = e.what
    return Result(Event.DONE, replace(context, trajectory=trajectory), record)


def _optimise(
    cell: Workcell, context: Context, method: str, found: GraspTrajectory | None, trusted: bool
) -> Outcome[GraspTrajectory]:
    """Optimise the step, from the arcs that were `found`; when they are trusted, only if they disappoint here."""
    garment, settings = context.known_garment, cell.settings.optimiser
    mesh, vertices = context.mesh, context.vertices
    assert mesh is not None and vertices is not None
    now, each = cell.ports.clock.now(), cell.settings.computing.simulation_s

    def progress(done: int, budget: int, best: float) -> None:
        cell.progress(done, budget, f"simulations at most, best D {best * 1e3:.1f} mm")

    def watch(done: int, candidate: Candidate, best: Candidate) -> None:
        arcs = {grasp_id: evaluate(c, _ARC) for grasp_id, c in candidate.controls.items()}
        own, so_far = ((c.dissimilarity, c.cost) for c in (candidate, best))
        cell.recorder.candidate(now + done * each, done, arcs, own, so_far)

    return cell.compute(
        lambda outcome: float(outcome.notes.get("simulations", 1)) * each,
        lambda: optimise_fold(
            context.step, mesh, vertices, garment.material, method,
            None if method == "initial" else settings.simulations,
            threads=settings.threads, progress=progress, max_tool_speed=_tool_speed(cell, garment),
            predict=_until_stopped(cell), start=None if found is None else dict(found.control_points),
            promised=found.dissimilarity if found is not None and trusted else None,
            promised_initial=None if found is None else found.dissimilarity_initial, watch=watch,
            lift_height=cell.settings.grasp.lift_height,
        ),
    )  # fmt: skip


def _until_stopped(cell: Workcell) -> Predictor:
    """The cloth simulation; none is begun after a stop, so that a search whose result is void ends soon."""
    simulate = ClothPredictor()

    def predict(mesh: Any, positions: Array, material: Material, paths: Mapping[GraspId, ToolPath], /) -> Array:
        failure = stopped(cell.ports)
        if failure:
            raise DriverError(failure.kind, failure.what, failure.hint)
        return simulate(mesh, positions, material, paths)

    return predict


def _draws(cell: Workcell, search: int) -> np.random.Generator:
    """The planner's draws, other ones for each further search: the same ones would fail again."""
    return cell.rng().spawn(search)[-1] if search else cell.rng()


def plan_motion(cell: Workcell, context: Context) -> Result:
    """Both arms' motion for the step, and the garment's shape that it is predicted to leave."""
    assert context.trajectory is not None
    garment = context.known_garment
    trajectory, step = _inwards(context.trajectory, context.step, INWARD * context.count(Adjustment.INWARD))
    speed = _tool_speed(cell, garment)
    paths = tool_paths(trajectory, step, speed)
    q_now = cell.ports.arms.state().q
    avoid = context.avoided if context.count(Adjustment.OTHER_SEARCH) else ()
    planned = cell.compute(
        cell.settings.computing.motion_s,
        lambda: plan_fold_motion(
            cell.robot, cell.checker, cell.table, step, paths, q_now, limits=cell.limits, tool_speed=speed,
            approach_height=cell.settings.motion.approach_height, lift=cell.settings.grasp.lift_height,
            rng=_draws(cell, context.count(Adjustment.OTHER_SEARCH)), avoid=avoid,
        ),
    )  # fmt: skip
    if planned.failure:
        return Result(Event.FAILED, context.with_failure(planned.failure))
    motion = planned.unwrap()
    context = replace(
        context, motion=motion, planned_paths=paths, planned_step=step, tool_speed=speed,
        avoided=(*context.avoided, motion.postures),
    )  # fmt: skip
    cell.recorder.arcs(cell.ports.clock.now(), {s: p.position for s, p in motion.tool_paths.items()})
    prediction = cell.compute(cell.settings.computing.simulation_s, lambda: _predict(cell, context, motion))
    context, missed = _believed(context, prediction)
    assert context.predicted is not None and context.mesh is not None
    cell.recorder.predicted(cell.ports.clock.now(), context.predicted)
    record = {
        "postures": {s.value: {"path": p.path.value, "turned": p.turned, "pitch_rad": p.pitch, "roll_rad": p.roll}
                     for s, p in motion.postures.items()},
        "fold_s": motion.fold.duration,
        "dissimilarity_m": missed,
        "search": dict(planned.notes),
    }  # fmt: skip
    failure = judge_prediction(step.name, missed, acceptance_limit(context.mesh.rest))
    if failure is not None:
        return Result(Event.FAILED, context.with_failure(failure), record)
    return Result(Event.APPROVAL_NEEDED if cell.approve else Event.DONE, context, record)


def named_garment(cell: Workcell, context: Context) -> Garment:
    """The garment that was named, or the one that was recognised, as its file describes it."""
    if cell.expected is not None:
        return cell.expected
    assert context.perception is not None
    return next(g for g in cell.garments if g.name == context.perception.garment)


def _tool_speed(cell: Workcell, garment: Garment) -> float:
    return min(garment.max_tool_speed, cell.settings.motion.tool_speed)


def _look_up(cell: Workcell, garment: Garment, step: FoldStep) -> GraspTrajectory | None:
    arms = len(step.grasps)
    entry = lookup(cell.library(), garment.category, step.name, garment.material, garment.size_m, arms=arms)
    if entry is None:
        return None
    return trajectory_from(entry, step, garment.material.thickness, _tool_speed(cell, garment))


def _described(trajectory: GraspTrajectory) -> dict[str, object]:
    return {
        "source": trajectory.source,
        "dissimilarity_m": trajectory.dissimilarity,
        "simulations": trajectory.simulations,
        "control_points_m": {s.value: np.round(c, 4).tolist() for s, c in trajectory.control_points.items()},
    }


def _inwards(trajectory: GraspTrajectory, step: FoldStep, inset: float) -> tuple[GraspTrajectory, FoldStep]:
    """The same fold with every grasp `inset` [m] nearer to the fold line, and its target likewise."""
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


def _predict(cell: Workcell, context: Context, motion: FoldMotion) -> FoldPrediction:
    """The step simulated with the tool paths that the arms will execute: orientation and time law included."""
    assert context.mesh is not None and context.vertices is not None
    return predict_fold(
        context.mesh, context.vertices, context.known_garment.material, simulated_paths(cell, motion),
        keyframes=KEY_FRAMES, grip_force=cell.grasp.grip_force,
    )  # fmt: skip


def simulated_paths(cell: Workcell, motion: FoldMotion) -> dict[GraspId, ToolPath]:
    """The tool paths of a motion by grasp, as a simulation takes them: the lift, then the arc."""
    height = cell.settings.grasp.lift_height
    return {posture.path: after_lift(motion.tool_paths[arm], height) for arm, posture in motion.postures.items()}


def _believed(context: Context, prediction: FoldPrediction) -> tuple[Context, float]:
    """The context with the predicted shape, and how far it is from the ideal fold: D [m]."""
    mesh = context.mesh
    assert mesh is not None
    target = target_vertices(mesh, context.step.lines, context.known_garment.material)
    missed = dissimilarity(target, prediction.vertices, mesh.triangles, mesh.area)
    shape = PredictedShape(prediction.vertices, mesh.triangles, mesh.rest)
    # what was seen of a try before belongs to that one
    context = replace(
        context, predicted=shape, plan_frames=prediction.keyframes, dissimilarity_m=missed, pictures=(),
        inspection=None, pressed=(), press_tries=0, unpressed=False,
    )  # fmt: skip
    return context, missed
