"""The effect that estimates in which state of a fold the garment lies after a failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from foldcell.cell.control.checks import stopped
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.planning.fold_planning import simulated_paths
from foldcell.cell.states.recovery_table import VERDICTS
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt, EstimateNote, Plan
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import DriverError, Failure, FailureKind
from foldcell.robots.ports import Array, CameraFrame, Side
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.state_estimate.drawing import draw_estimate
from foldcell.skills.state_estimate.estimate import COMPLETED, PRIORS, StateEstimate, estimate_state
from foldcell.skills.state_estimate.hand_course import HandCourse, held_until, without_gaps
from foldcell.skills.state_estimate.hypothesis import FoldState, Interruption
from foldcell.skills.state_estimate.interrupted_fold import simulate_interruptions
from foldcell.skills.state_estimate.observation import Observation, observe
from foldcell.skills.state_estimate.turned_corner import with_turned_corner
from foldcell.skills.state_estimate.wording import describe
from foldcell.skills.vocabulary import GraspId, Outcome, PredictedShape

SURE = 0.8
"""Smallest confidence with which the state of the garment ends the attempt. Below it, the more probable
of the states before and after the fold is assumed, and recognition or inspection decides whether it is true."""


@effect
def estimate(cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, frame: CameraFrame) -> Result:
    """Estimate whether the garment lies as before the fold, half folded, as after the fold, or in a heap, and
    choose the event: find the garment again, inspect the fold, or fail with the state in words."""
    context, found = context.need(note_estimate(cell, context, plan, attempt, frame))
    says = context.estimates[-1].says
    record = _record(found, says)
    state = found.state
    if found.confidence < SURE:  # recognition or inspection decides
        state = max((FoldState.BEFORE, FoldState.AFTER), key=lambda s: found.probabilities[s])
    if state is FoldState.AFTER:
        context = context.with_attempt(replace(attempt, carried=True, interrupted=True))
        return Result(Event.FOLD_MADE, context, record)
    if state is FoldState.BEFORE:
        return Result(Event.DONE, context, record)
    failure = Failure(
        FailureKind.HEAPED if state is FoldState.HEAP else FailureKind.HALF_FOLDED,
        f"fold {attempt.step.name}: {says}",
        "lay the garment as it was before this fold (its outline is in the report), then retry",
        {"confidence": found.confidence},
    )
    return context.failed(failure, record)


def note_estimate(
    cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, frame: CameraFrame
) -> Outcome[tuple[RunContext, StateEstimate]]:
    """Estimate the state of the garment. Returns the context with the estimate, which is also recorded."""
    outcome = _estimated(cell, context, plan, attempt, frame)
    if outcome.failure:
        return Outcome(failure=outcome.failure)
    seen, found = outcome.unwrap()
    hands = {posture.path: arm.value for arm, posture in attempt.motion.postures.items()}
    says, now = describe(found, hands), cell.ports.clock.now()
    note = EstimateNote(context.fold.index, now, says, draw_estimate(seen, found))
    cell.recorder.estimated(now, says, note.picture, found.best.shape if found.best else None)
    fold = replace(context.fold, estimate=found.condensed())
    return Outcome((replace(context, fold=fold, estimates=(*context.estimates, note)), found))


def _estimated(
    cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, frame: CameraFrame
) -> Outcome[tuple[Observation, StateEstimate]]:
    """Compute the estimate on a worker. The simulated cell charges its time for an inspection and for each
    simulation."""
    sight, costs = context.sight, cell.settings.computing
    calibration, paths = sight.calibration(cell.calibration), simulated_paths(cell.settings, attempt.motion)
    before = PredictedShape(plan.vertices, plan.mesh.triangles, plan.mesh.rest)
    top = context.recognition.perception.top if context.recognition else 0.0
    lift = max(top - float(plan.vertices[:, 2].min()), 0.0)
    several_layers = any(grasp.layers > 1 for grasp in attempt.step.grasps.values())
    course = _hand_course(cell, {arm: p.path for arm, p in attempt.motion.postures.items()})
    priors = COMPLETED if _uneventful(context) else PRIORS

    def proceed() -> None:
        failure = stopped(cell.ports)
        if failure:
            raise DriverError(failure.kind, failure.what, failure.hint)

    def simulate(ways: Sequence[Interruption]) -> list[Array]:
        return simulate_interruptions(
            plan.mesh, plan.vertices, plan.garment.material, paths, ways, cell.grasp.grip_force, proceed,
            cell.settings.gripper.pads, course,
        )  # fmt: skip

    def work() -> Outcome[tuple[Observation, StateEstimate]]:
        seen = observe(frame, calibration, cell.table, sight.reference, sight.previous, settings=cell.perception)
        if seen.failure:
            return Outcome(failure=seen.failure)
        found = estimate_state(
            seen.unwrap(),
            before,
            attempt.predicted,
            list(paths),
            simulate,
            lift,
            several_layers,
            priors,
            measured=course is not None,
        )
        thickness = plan.garment.material.thickness
        return Outcome((seen.unwrap(), with_turned_corner(found, seen.unwrap(), attempt.step.grasps, thickness)))

    def cost(outcome: Outcome[tuple[Observation, StateEstimate]]) -> float:
        simulations = outcome.value[1].simulations if outcome.value else 0
        return costs.inspection_s + simulations * costs.simulation_s

    return cell.compute(cost, work)


def _hand_course(cell: Workcell, grasps: Mapping[Side, GraspId]) -> HandCourse | None:
    """Return the measured course of the hands since they lifted the cloth; None if none was recorded. grasps: of
    each hand."""
    stamps, q, openings = cell.hand_record.readings()
    if len(stamps) < 2:
        return None
    t = without_gaps(stamps, q)
    position, rotation, until = {}, {}, {}
    for side, grasp_id in grasps.items():
        poses = np.array([tool_pose(cell.robot.chains[side], row) for row in q[:, cell.robot.arm(side)]])
        position[grasp_id] = poses[:, :3, 3] - np.array([0.0, 0.0, cell.table.height])
        rotation[grasp_id] = poses[:, :3, :3]
        opening = openings[:, list(Side).index(side)]
        held = held_until(t, opening, cell.grasp.empty_opening, cell.grasp.slip_opening_fraction)
        clung = cell.hand_record.clung_until.get(side)
        until[grasp_id] = held if clung is None else float(t[np.searchsorted(stamps, clung)])
    return HandCourse(t, position, rotation, until)


def _uneventful(context: RunContext) -> bool:
    """Whether the hands completed the fold and nothing but verdicts of inspections spoke against it."""
    failed = {kind for index, kind in context.attempts if index == context.fold.index}
    return context.fold.carried and failed <= {kind.value for kind in VERDICTS}


def _record(found: StateEstimate, says: str) -> dict[str, object]:
    """Return the figures for the journal."""
    how = found.best.hypothesis.interruption if found.best else None
    moved = {"drift_m": found.best.drift_m, "drift_rad": found.best.drift_rad} if found.best else {}
    return {
        "state": found.state.value,
        "confidence": found.confidence,
        "says": says,
        "probabilities": {state.value: p for state, p in found.probabilities.items()},
        "simulations": found.simulations,
        "interrupted_at": how.begins if how else None,
        "as_measured": how is not None and how.measured,
        **moved,
    }
