"""Effects that judge a fold: what lies there against what the simulation predicted, and what follows from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.executive.effects.adapting import adapt
from cell.executive.effects.drift import apply_drift
from cell.executive.effects.pressing import plan_pressing
from cell.hardware.workcell import Workcell
from cell.states.fold_context import FoldContext
from cell.states.run_context import Result, RunContext
from cell.states.stages import Attempt, Plan
from cell.states.transition_table import Event
from robots.errors import Failure, FailureKind
from robots.ports import CameraFrame
from skills.perception.inspection.diagnosis import beyond_limits, diagnose, diagnosed_by_height, outline_matches
from skills.perception.inspection.inspect import Inspection, InspectionSettings, inspect
from skills.perception.registration.alignment import edge_deviation
from skills.vocabulary import FoldStep, Outcome, PredictedShape

__all__ = ["find_folded", "inspect_fold", "judged_as_before", "next_step"]

DISPLACED = 0.010
"""An outline that pressing displaced by so much is judged as any other [m]: corners that turn up move more."""

HINTS = {
    FailureKind.DRIFT: "the garment moved as a whole: a rougher table or a slower fold",
    FailureKind.PILING: "cloth is heaped up: a lower arc near the target",
    FailureKind.SAG: "the part between the hands hung: hold it wider apart",
    FailureKind.DROPPED_CORNER: "a corner was lost on the way: grip lower or harder",
    FailureKind.MISSED_LAYER: "not all layers were taken: grip lower",
}


def inspect_fold(cell: Workcell, context: RunContext, plan: Plan, made: Attempt, frame: CameraFrame) -> Result:
    """Accept the fold, or name what went wrong with it."""
    step = plan.steps[context.fold.index]
    outcome = _compare(cell, context, frame, made.predicted, step, made.before)
    if outcome.failure:
        return Result(Event.FAILED, context.with_failure(outcome.failure))
    seen = outcome.unwrap()
    if made.pressed:
        seen = judged_as_before(made.pressed[0], seen, step, cell.inspection)
    made = replace(made, inspection=seen)
    context = context.with_attempt(made)
    cell.recorder.observed(cell.ports.clock.now(), seen.contour)
    if seen.diagnosis is None or diagnosed_by_height(seen, cell.inspection):
        press_plan = plan_pressing(cell, context.fold.index, plan, made, seen)
        if press_plan is not None:
            event = Event.APPROVAL_NEEDED if cell.approve else Event.PRESS
            context = context.with_attempt(replace(made, press_plan=press_plan))
            return Result(event, context, {**figures(seen), "dabs": press_plan.dabs})
    if seen.diagnosis is None:
        garment, learned = adapt(cell, context.fold.index, plan, made, seen)
        context = replace(context, plan=replace(plan, garment=garment))
        ended = next_step(cell, context)
        return replace(ended, record={**figures(seen), **learned, **ended.record})
    failure = Failure(
        seen.diagnosis,
        f"fold {step.name}: {', '.join(beyond_limits(seen, cell.inspection))}",
        HINTS.get(seen.diagnosis, "compare the observed with the predicted shape in the recording"),
        figures(seen),
    )
    return Result(Event.FAILED, context.with_failure(failure), figures(seen))


def judged_as_before(
    before: Inspection, seen: Inspection, step: FoldStep, settings: InspectionSettings
) -> Inspection:
    """What is seen after a fold was pressed, judged anew, but for an outline that was good and lies as it lay: a
    crease that is pressed reaches further out than the unpressed one that was predicted."""
    displaced, _ = edge_deviation(before.contour, seen.contour)
    if not outline_matches(before, settings) or abs(displaced) >= DISPLACED:
        return seen
    kind, confidence = diagnose(replace(seen, edge_deviation_m=before.edge_deviation_m), step, settings)
    return replace(seen, diagnosis=kind, confidence=confidence)


def next_step(cell: Workcell, context: RunContext) -> Result:
    """Past the fold at hand: what was predicted is now believed, moved to where it is seen. After the last one the
    garment is folded, unless the operator left folds out."""
    ending, index, steps = context.failure, context.fold.index, context.steps
    past = replace(_noted(context), failure=None)
    if index + 1 < len(steps):
        return Result(Event.NEXT_FOLD, replace(past, fold=FoldContext(index + 1)))
    past = replace(past, fold=FoldContext(index))
    made = {note.name for note in past.done}
    left_out = [step.name for step in steps if step.name not in made]
    if steps and not left_out:
        return Result(Event.ALL_FOLDED, past)
    if left_out:
        ending = Failure(FailureKind.ABORTED, f"left out by the operator: {', '.join(left_out)}")
    return Result(Event.GIVE_UP, replace(past, failure=ending, through=bool(steps)))


def find_folded(cell: Workcell, context: RunContext, plan: Plan, frame: CameraFrame) -> Result:
    """Between two folds: the garment is where the believed shape lies best over what is seen."""
    believed = PredictedShape(plan.vertices, plan.mesh.triangles, plan.mesh.rest)
    outcome = _compare(cell, context, frame, believed, None, None)
    if outcome.failure:
        return Result(Event.FAILED, context.with_failure(outcome.failure))
    seen = outcome.unwrap()
    cell.recorder.observed(cell.ports.clock.now(), seen.contour)
    if seen.iou_aligned < cell.settings.inspection.iou:
        failure = Failure(
            FailureKind.NOT_FLAT,
            f"the garment does not lie as the last fold left it (overlap {seen.iou_aligned:.2f})",
            "lay it back as it was and go on (foldcell resume last), or lay it flat and start again",
            figures(seen),
        )
        return Result(Event.FAILED, context.with_failure(failure), figures(seen))
    return Result(Event.DONE, replace(context, plan=apply_drift(plan, seen)), figures(seen))


def figures(seen: Inspection) -> dict[str, float]:
    """An inspection as plain numbers; what nobody could see is left out."""
    edge = {} if seen.edge is None else {"edge_corner_m": seen.edge.corner, "edge_sag_m": seen.edge.sag}
    hard_to_see = {"height_m": seen.height_m, "missing_layer": seen.missing_layer, **edge}
    return {
        "iou": seen.iou,
        "iou_aligned": seen.iou_aligned,
        "drift_m": seen.drift_m,
        "drift_rad": seen.drift_rad,
        "extra_height_m": seen.extra_height_m,
        "edge_deviation_m": seen.edge_deviation_m,
        "confidence": seen.confidence,
        **{name: value for name, value in hard_to_see.items() if np.isfinite(value)},
    }


def _compare(
    cell: Workcell,
    context: RunContext,
    frame: CameraFrame,
    shape: PredictedShape,
    made: FoldStep | None,
    before: CameraFrame | None,
) -> Outcome[Inspection]:
    """What is seen against a shape. made: the fold that has just been made, None where none has; before: the
    picture before it."""
    sight = context.sight
    flat_top = context.recognition.perception.top if context.recognition else None
    return cell.compute(
        cell.settings.computing.inspection_s,
        lambda: inspect(
            frame, sight.calibration(cell.calibration), cell.table, sight.reference, shape,
            made, cell.inspection, sight.previous, flat_top, before,
        ),
    )  # fmt: skip


def _noted(context: RunContext) -> RunContext:
    """The fold on record, with the predicted shape as the belief of where the garment lies: a fold that was
    carried through is believed, and made once somebody has seen what came of it, who also saw where it lies."""
    note, plan = context.fold.note(), context.plan
    if note is None or plan is None or not (context.fold.carried or note.inspected):  # the operator left it out
        return context
    plan = replace(plan, vertices=note.predicted.vertices)
    if note.inspected is None:
        return replace(context, plan=plan)
    return replace(context, done=(*context.done, note), plan=apply_drift(plan, note.inspected))
