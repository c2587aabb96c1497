"""Makes the claim about the last fold: whether the garment is folded, from the camera alone."""

from __future__ import annotations

import numpy as np

from foldcell.cell.executive.effects.grasping import LEARNED_ERROR
from foldcell.cell.hardware.workcell import Workcell
from foldcell.cell.states.run_context import RunContext
from foldcell.cell.states.stages import Attempt, FoldNote, Plan, with_drift
from foldcell.robots.errors import Failure, FailureKind
from foldcell.skills.fold_plan.folding import fold_xy, folded_creases, target_vertices
from foldcell.skills.perception.inspection.claim import Claim
from foldcell.skills.perception.inspection.claiming import Layers, SeenFolds, claim_fold, displacement_of
from foldcell.skills.perception.inspection.diagnosis import lasting_defect
from foldcell.skills.perception.inspection.height_expectation import (
    CameraBias,
    IdealHeights,
    Normal,
    rising,
    scaled_ideal_heights,
)
from foldcell.skills.perception.inspection.predicted_view import outline_of
from foldcell.skills.perception.inspection.result import Inspection, InspectionSettings
from foldcell.skills.perception.inspection.target_view import FoldTarget, TargetView
from foldcell.skills.perception.registration.alignment import align, edge_deviation
from foldcell.skills.vocabulary import PredictedShape, frozen

DISTORTED = 0.003
"""If a disturbance leaves the outline further off than before by more than this [m], near the layers that a fold
has laid, layers below have moved, too. Twice, the second fold of a small towel was begun and taken back. The
outline of the first was then 12 and 6 mm off (before, in the second case, 2 mm), and the edges of the finished
towel 54 and 33 mm."""

HINTS = {
    FailureKind.TOO_HIGH: "press its creases by hand, or allow more pressing (pressing.max_attempts in cell.yaml)",
    FailureKind.OFF_TARGET: "lay the garment flat in mid-table and start a new run (simulated: another seed)",
}


def fold_target(plan: Plan, index: int) -> FoldTarget | None:
    """Return the perfect fold after step `index` with its creases, at the place where the plan now expects the
    garment. The claim needs only the first step, which shows the fabric, and the last one: return None for all
    others."""
    if 0 < index < len(plan.steps) - 1:
        return None
    mesh, lines = plan.mesh, plan.steps[index].lines
    shape = PredictedShape(target_vertices(mesh, lines, plan.garment.material), mesh.triangles, mesh.rest)
    return FoldTarget(shape, folded_creases(lines, plan.flat.contour))


def make_claim(
    cell: Workcell, context: RunContext, plan: Plan, attempt: Attempt, inspection: Inspection
) -> Claim | None:
    """Make the claim about the last fold. None after other folds."""
    target, errors = inspection.target, cell.inspection.claim
    if target is None or context.fold.index < len(plan.steps) - 1:
        return None
    first = _first_crease(context, plan, cell.inspection)
    look = context.first_look
    R, t = align(look.contour, plan.flat.contour) if look else (np.eye(2), np.zeros(2))
    bias = look.bias if look else CameraBias(errors.camera_bias, errors.camera_bias_sigma, measured=False)
    layers = _layers(context, plan, errors.thickness_spread)
    return claim_fold(
        inspection, target, displacement_of(target, R, t), bias, _ideal_heights(cell, plan, target, first), first,
        layers, cell.inspection, _seen_folds(context, plan, attempt, cell.inspection),
    )  # fmt: skip


def _layers(context: RunContext, plan: Plan, spread: float) -> Layers:
    """Return what is known of the garment's layers. The hands measure a layer between their pads."""
    nominal, stated = plan.nominal, plan.nominal.material.thickness
    if context.measured_layer is None:
        return Layers(nominal.layers, stated, Normal(stated, nominal.thickness_sigma(spread)))
    known = nominal.thickness_of(context.measured_layer)
    return Layers(nominal.layers, stated, Normal(known, LEARNED_ERROR * known))


def _seen_folds(context: RunContext, plan: Plan, attempt: Attempt, settings: InspectionSettings) -> SeenFolds:
    """Return what was seen of all folds. An earlier fold is doubtful if an inspection refused it for a defect that
    a later fold can hide."""
    steps = {step.name: step for step in plan.steps}
    refused = [(note.name, note.inspected) for note in context.done if note.inspected and not note.accepted]
    folds = (*context.done, FoldNote(attempt, 0))
    distorted = [note.name for note in context.done if _more_off(note) > DISTORTED]
    lasting = [name for name, seen in refused if lasting_defect(seen, steps[name], settings) is not None]
    return SeenFolds(
        tuple(dict.fromkeys((*lasting, *distorted))),
        tuple(note.name for note in folds if note.hidden or note.attempt.disturbed),
        tuple(note.inspected for note in context.done if note.inspected),
        bool(context.repairs) or any(note.anew or note.hidden or note.attempt.disturbed for note in folds),
    )


def _more_off(note: FoldNote) -> float:
    """Return by how much further off the outline was after a disturbance than before [m]; 0 if it was not seen.
    Only the outline near the layers that the fold has laid tells of them: a hem that is laid back crooked is
    carried once more, and the sleeves lie as before."""
    before, anew = note.attempt.inspection, note.anew
    if before is None or anew is None:
        return 0.0
    step, shape = note.attempt.step, note.attempt.predicted
    laid = shape.vertices[step.line.signed_distance(fold_xy(step.earlier, shape.material)) > 0.0, :2]
    was, now = (
        edge_deviation(with_drift(outline_of(s.view, s.predicted), s), s.contour, with_drift(laid, s))[0]
        for s in (before, anew)
    )
    return abs(now) - abs(was)


def claim_failure(claim: Claim) -> Failure:
    """Return the failure of a claim that does not hold."""
    kind = FailureKind.TOO_HIGH if claim.shape else FailureKind.OFF_TARGET
    values = {
        "height_m": claim.height_m,
        "height_limit_m": claim.height_limit_m,
        "crease_height_m": claim.crease_height_m,
        "crease_height_limit_m": claim.crease_height_limit_m,
        "target_iou": claim.target_iou,
        "drift_m": claim.drift_m,
    }
    known = {name: value for name, value in values.items() if np.isfinite(value)}
    return Failure(kind, claim.says, HINTS[kind], known)


def _first_crease(context: RunContext, plan: Plan, settings: InspectionSettings) -> TargetView | None:
    """Return the view of the first fold before it was pressed, if the shape of this fold was good, else None.
    Return None also if the first fold is the last one, because a fold is not judged by its own height, and if the
    first fold was repaired: cloth that was carried twice stands higher than its fabric explains (once 35 mm in
    place of 25)."""
    if len(plan.steps) < 2 or not context.done or any(index == 0 for index, _ in context.repairs):
        return None
    note, step = context.done[0], plan.steps[0]
    if note.name != step.name or note.inspected is None:
        return None
    if not note.accepted and lasting_defect(note.inspected, step, settings) is not None:
        return None
    return (*note.attempt.pressed, note.inspected)[0].target


def _ideal_heights(cell: Workcell, plan: Plan, last: TargetView, first: TargetView | None) -> IdealHeights:
    """Return the heights of the ideal fold over the fabric's range of bending lengths. They were computed with the
    trajectory library. If they were not, they are scaled from the predictions of this run's folds."""
    computed = cell.ideal_heights(plan.nominal)
    if computed:
        columns = (
            np.array([getattr(h, name) for h in computed])
            for name in ("bending_length", "height", "crease_height", "first_crease")
        )
        return rising(IdealHeights(*map(frozen, columns)))
    cell.tell(
        "how high this fabric may stand is estimated from this run's predictions; `foldcell library build` with"
        " the garment's name or file computes it"
    )
    first = first or last
    return scaled_ideal_heights(
        last.flat, last.predicted, first.flat.crease_height_m, first.predicted.crease_height_m,
        plan.nominal.material.bending_length, plan.nominal.bending_factors,
    )  # fmt: skip
