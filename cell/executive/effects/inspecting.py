"""Effects that judge a fold: they compare the observed with the predicted shape and choose the next event."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.cell.executive.effects.adapting import adapt
from foldcell.cell.executive.effects.claiming import claim_failure, fold_target, make_claim
from foldcell.cell.executive.effects.pressing import plan_pressing
from foldcell.cell.executive.effects.recovery.estimating import note_estimate
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.run_context import Result, RunContext, effect
from foldcell.cell.states.stages import Attempt, Plan, with_drift
from foldcell.cell.states.transition_table import Event
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.ports import CameraFrame
from foldcell.skills.perception.inspection.claim import claim_to_dict
from foldcell.skills.perception.inspection.diagnosis import (
    beyond_limits,
    diagnose,
    diagnosed_by_height,
    outline_matches,
)
from foldcell.skills.perception.inspection.inspect import inspect
from foldcell.skills.perception.inspection.result import Inspection, InspectionSettings
from foldcell.skills.perception.inspection.target_view import FoldTarget
from foldcell.skills.perception.registration.alignment import edge_deviation
from foldcell.skills.state_estimate.hypothesis import FoldState
from foldcell.skills.vocabulary import FoldStep, Outcome, PredictedShape

DISPLACED = 0.010
"""If pressing displaces the outline by at least this [m], the outline after pressing is judged, because something
has moved, for example a corner that turned up. If it displaces the outline less and the outline was good before
pressing, the outline before pressing is judged."""

HINTS = {
    FailureKind.DRIFT: "the garment moved as a whole: lay a rougher cloth under it, or lower motion.tool_speed",
    FailureKind.PILING: "cloth is heaped up: smooth it by hand; if it recurs, optimise the arcs of this garment",
    FailureKind.SAG: "the part between the hands sagged: grasp it wider apart (the folds in the garment file)",
    FailureKind.DROPPED_CORNER: "a corner was dropped during the fold: raise grasp.grip_force",
    FailureKind.MISSED_LAYER: "not all layers were moved: put them right by hand, or raise grasp.contact_force",
}


@effect
def inspect_fold(cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, frame: CameraFrame) -> Result:
    """Judge the fold by the picture: accept it, press it, or diagnose its failure."""
    if not cell.settings.inspection.enabled:
        return next_step(cell, context)
    step = plan.steps[context.fold.index]
    attempt, inspection = context.need(judge_fold(cell, context, plan, attempt, frame))
    claim = attempt.claim
    context = context.with_attempt(attempt)
    record: dict[str, object] = {**figures(inspection)}
    if claim is not None:
        record["claim"] = claim_to_dict(claim)
    cell.recorder.observed(cell.ports.clock.now(), inspection.contour)
    too_high = claim is not None and claim.shape and not claim.flat
    if inspection.diagnosis is None or too_high or diagnosed_by_height(inspection, cell.inspection):
        press_plan = plan_pressing(cell, context.fold.index, plan, attempt, inspection)
        if press_plan is not None:
            event = Event.APPROVAL_NEEDED if cell.approve else Event.PRESS
            context = context.with_attempt(replace(attempt, press_plan=press_plan))
            return Result(event, context, {**record, "dabs": press_plan.dabs})
    drifted = inspection.diagnosis is FailureKind.DRIFT
    if claim is not None and not claim.holds and (inspection.diagnosis is None or (drifted and too_high)):
        failure, state = claim_failure(claim), ""
        if failure.kind is FailureKind.TOO_HIGH and claim.too_high:  # it may be folded anew
            context, state = _estimated(cell, context, plan, attempt, frame)
        else:  # an estimate of an earlier look does not undo a fold that is only doubtful
            context = replace(context, fold=replace(context.fold, estimate=None))
        values = {**figures(inspection), **failure.values}
        failure = replace(failure, what=f"{failure.what}{state}", values=values)
        return context.failed(failure, record)
    piled = inspection.diagnosis is FailureKind.PILING
    if inspection.diagnosis is None or (piled and claim is not None and claim.holds):
        learned: dict[str, object] = {}
        if not attempt.repaired:
            garment, learned = adapt(cell, context.fold.index, plan, attempt, inspection)
            context = replace(context, plan=replace(plan, garment=garment))
        advanced = next_step(cell, context)
        return replace(advanced, record={**record, **learned, **advanced.record})
    state = ""
    if not drifted:  # the fold is carried on from, where it lies
        context, state = _estimated(cell, context, plan, attempt, frame)
    failure = Failure(
        inspection.diagnosis,
        f"fold {step.name}: {', '.join(beyond_limits(inspection, cell.inspection))}{state}",
        HINTS.get(inspection.diagnosis, "compare the observed with the predicted shape in the recording"),
        figures(inspection),
    )
    return context.failed(failure, record)


def judge_fold(
    cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, frame: CameraFrame
) -> Outcome[tuple[Attempt, Inspection]]:
    """Inspect the fold in the picture, and make the claim about the last fold. Return the attempt with both, and
    the inspection."""
    step, target = plan.steps[context.fold.index], fold_target(plan, context.fold.index)
    outcome = _compare(
        cell, context, frame, attempt.predicted, step, attempt.before, target, _earlier_look(attempt)
    )
    if outcome.failure:
        return Outcome(failure=outcome.failure)
    inspection = outcome.unwrap()
    if attempt.pressed:
        inspection = judged_as_before(attempt.pressed[0], inspection, step, cell.inspection)
    claim = make_claim(cell, context, plan, attempt, inspection)
    return Outcome((replace(attempt, inspection=inspection, claim=claim), inspection))


def _earlier_look(attempt: Attempt) -> Inspection | None:
    """Return the last inspection of this fold, if nothing has pressed on it since."""
    seen = attempt.inspection
    return None if attempt.pressed and attempt.pressed[-1] is seen else seen


def _estimated(
    cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, frame: CameraFrame
) -> tuple[RunContext, str]:
    """Estimate the state of a garment that is not as predicted, so that the fold can be repaired. This is done
    once per attempt. Returns the context with the estimate, and the state in words for the failure. The words are
    empty if the fold is made or nothing was estimated."""
    if context.fold.estimate is not None:
        return context, ""
    outcome = note_estimate(cell, context, plan, attempt, frame)
    if outcome.failure:
        return context, ""
    estimated, found = outcome.unwrap()
    made = found.state is FoldState.AFTER
    return estimated, "" if made else f"; {estimated.estimates[-1].says}"


def judged_as_before(
    before: Inspection, after: Inspection, step: FoldStep, settings: InspectionSettings
) -> Inspection:
    """Return the inspection after pressing, with a corrected diagnosis and overlap. If the outline was good before
    pressing and pressing did not displace it, the diagnosis uses the outline's deviation before pressing, and the
    overlap with the prediction is no smaller than before, because a pressed crease reaches further out than the
    predicted crease, which is not pressed. A moved edge that lay in its place before pressing still does."""
    displaced, _ = edge_deviation(before.contour, after.contour)
    if not outline_matches(before, settings) or abs(displaced) >= DISPLACED:
        return after
    after = replace(after, iou_aligned=max(before.iou_aligned, after.iou_aligned))
    still = replace(after, edge_deviation_m=before.edge_deviation_m)
    kind, confidence = diagnose(still, step, settings)
    if kind in {FailureKind.SAG, FailureKind.DROPPED_CORNER} and before.edge is not None:
        kind, confidence = diagnose(replace(still, edge=before.edge), step, settings)
    return replace(after, diagnosis=kind, confidence=confidence)


def next_step(cell: Workcell, context: RunContext) -> Result:
    """Advance to the next fold. The predicted shape, moved by the observed drift, becomes the believed shape.
    After the last fold, the run ends as folded, unless the operator skipped folds or the claim does not hold."""
    context = replace(context, fold=context.fold.after_repair())
    ending, index, steps = context.failure, context.fold.index, context.steps
    advanced = replace(_with_step_note(context, cell.settings.inspection.enabled), failure=None)
    note = context.fold.note()
    if note is not None and note.accepted and context.fold.layer_thickness is not None:
        advanced = replace(advanced, layer_thickness=context.fold.layer_thickness)
    if index + 1 < len(steps):
        return Result(Event.NEXT_FOLD, replace(advanced, fold=FoldContext(index + 1)))
    claim = context.claim()
    advanced = replace(advanced, fold=FoldContext(index))
    done = {note.name for note in advanced.done}
    skipped = [step.name for step in steps if step.name not in done]
    if steps and not skipped and (claim is None or claim.holds):
        return Result(Event.ALL_FOLDED, advanced)
    if skipped:
        ending = Failure(FailureKind.ABORTED, f"left out by the operator: {', '.join(skipped)}")
    elif claim is not None:
        ending = claim_failure(claim)
    return Result(Event.GIVE_UP, replace(advanced, failure=ending, through=bool(steps)))


@effect
def find_folded(cell: Workcell, context: RunContext, plan: Plan, frame: CameraFrame) -> Result:
    """Locate the garment between two folds by aligning the believed shape with the picture."""
    believed = PredictedShape(plan.vertices, plan.mesh.triangles, plan.mesh.rest)
    inspection = context.need(_compare(cell, context, frame, believed, None, None))
    cell.recorder.observed(cell.ports.clock.now(), inspection.contour)
    if inspection.iou_aligned < cell.settings.inspection.iou:
        failure = Failure(
            FailureKind.NOT_FLAT,
            f"the garment does not lie as the last fold left it (overlap {inspection.iou_aligned:.2f})",
            "lay it back as it was and resume (foldcell resume last), or lay it flat and start again",
            figures(inspection),
        )
        return context.failed(failure, figures(inspection))
    context = replace(context, plan=plan.drifted(inspection))
    if context.disturbed or context.fold.touched:
        context = context.need(_seen_anew(cell, context, frame))
    if context.disturbed and context.first_look is not None:
        # the claim judges only what the cell has displaced: the place of the first look moves with the garment
        moved = with_drift(context.first_look.contour, inspection)
        context = replace(context, first_look=replace(context.first_look, contour=moved))
    found = replace(context, disturbed=False, fold=replace(context.fold, touched=False))
    return Result(Event.DONE, found, figures(inspection))


def _seen_anew(cell: Workcell, context: RunContext, frame: CameraFrame) -> Outcome[RunContext]:
    """Return the context with what the picture shows of the last fold, because the garment was disturbed since its
    inspection. It may lie anywhere, so neither its drift nor its angle counts. What later folds hide of the folds
    before it is not known any more."""
    last = context.done[-1] if context.done else None
    if last is None or last.inspected is None:
        return Outcome(context)
    attempt, known = last.attempt, last.inspected
    outcome = _compare(cell, context, frame, attempt.predicted, attempt.step, attempt.before)
    if outcome.failure:
        return Outcome(failure=outcome.failure)
    seen = replace(outcome.unwrap(), drift_m=0.0, target=known.target)
    kind, confidence = diagnose(replace(seen, drift_rad=0.0), attempt.step, cell.inspection)
    seen = replace(seen, diagnosis=kind, confidence=confidence)
    done = (*(replace(note, hidden=True) for note in context.done[:-1]), replace(last, anew=seen))
    return Outcome(replace(context, done=done))


def figures(inspection: Inspection) -> dict[str, float]:
    """Return the figures of an inspection as plain numbers, without the values that could not be measured."""
    edge, target = inspection.edge, inspection.target
    behind = [length for length in inspection.left_behind.values() if np.isfinite(length)]
    measured = {"left_behind_m": max(behind, default=np.nan)}
    measured |= {"height_m": inspection.height_m, "missing_layer": inspection.missing_layer}
    if edge is not None:
        measured |= {"edge_corner_m": edge.corner, "edge_sag_m": edge.sag}
    if target is not None:
        measured |= {
            "target_iou": target.iou,
            "stack_height_m": target.observed.height_m,
            "crease_height_m": target.observed.crease_height_m,
            "predicted_height_m": target.predicted.height_m,
            "predicted_crease_height_m": target.predicted.crease_height_m,
        }
    return {
        "iou": inspection.iou,
        "iou_aligned": inspection.iou_aligned,
        "drift_m": inspection.drift_m,
        "drift_rad": inspection.drift_rad,
        "extra_height_m": inspection.extra_height_m,
        "edge_deviation_m": inspection.edge_deviation_m,
        "confidence": inspection.confidence,
        **{name: value for name, value in measured.items() if np.isfinite(value)},
    }


def _compare(
    cell: Workcell,
    context: RunContext,
    frame: CameraFrame,
    shape: PredictedShape,
    step: FoldStep | None,
    before: CameraFrame | None,
    target: FoldTarget | None = None,
    earlier: Inspection | None = None,
) -> Outcome[Inspection]:
    """Compare the picture with a shape. step: the fold that was just made, or None; before: the picture taken
    before that fold. target: the perfect fold, for the claim. earlier: an earlier look at the same fold."""
    sight = context.sight
    flat_top = context.recognition.perception.top if context.recognition else None
    return cell.compute(
        cell.settings.computing.inspection_s,
        lambda: inspect(
            frame, sight.calibration(cell.calibration), cell.table, sight.reference, shape,
            step, settings=cell.inspection, previous=sight.previous, flat_top=flat_top, before=before,
            target=target, earlier=earlier,
        ),
    )  # fmt: skip


def _with_step_note(context: RunContext, inspecting: bool) -> RunContext:
    """Return the context after a fold. The predicted shape of a completed fold becomes the believed shape. An
    inspected fold is also added to `done`, and the plan moves by the measured drift. inspecting: False if folds
    are never inspected; then every completed fold is added to `done`."""
    note, plan = context.fold.note(), context.plan
    if note is None or plan is None or not (context.fold.carried or note.inspected):  # the operator skipped it
        return context
    plan = replace(plan, vertices=note.attempt.predicted.vertices)
    if note.inspected is None and not inspecting:
        return replace(context, done=(*context.done, note), plan=plan)
    if note.inspected is None:
        return replace(context, plan=plan)
    return replace(context, done=(*context.done, note), plan=plan.drifted(note.inspected))
