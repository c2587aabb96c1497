"""Applies the operator's edits to the plan of the present fold, and says which edits cannot be made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from foldcell.cell.states.fold_context import FoldContext
from foldcell.cell.states.plan_edit import PlanEdit, with_edit
from foldcell.cell.states.recovery_table import Adjustment
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.ports import frozen
from foldcell.skills.fold_plan.folding import silhouette
from foldcell.skills.vocabulary import FoldStep, GarmentState

LEAST_FLAP = 0.02
"""A grasp is at least so far from the fold line [m]: two pads have to fit between."""
FARTHEST = 0.10
"""A key point is moved by at most this distance [m]. If it lies farther off, the garment was not recognised."""
EDGE = 0.01
"""A grasp may lie at most so far outside the garment's outline [m], which is seen with an error."""


def refusal(edit: PlanEdit, context: RunContext) -> str | None:
    """Return why the edit cannot be made with the present plan, or None if it can be tried."""
    plan, fold = context.plan, context.fold
    if plan is None or fold.attempt is None or fold.repair is not None:
        return "there is no plan of a fold that can be changed"
    if edit.keypoints and fold.index > 0:
        return "key points can be moved before the first fold only"
    for name, point in edit.keypoints.items():
        if name not in plan.flat.keypoints:
            return f"there is no key point {name}"
        distance = float(np.linalg.norm(np.subtract(point, plan.flat.keypoints[name])))
        if distance > FARTHEST:
            limit = f"{1e3 * FARTHEST:.0f} mm is the limit"
            return f"the key point was moved by {1e3 * distance:.0f} mm, and {limit}: look again"
    step = fold.attempt.step
    garment = shapely.Polygon(silhouette(step.earlier, plan.flat.contour)).buffer(EDGE)
    for grasp_id, point in edit.grasps.items():
        if grasp_id not in step.grasps:
            return f"this fold has no {grasp_id.value} grasp"
        if not garment.contains(shapely.Point(point)):
            return "the grasp is not on the garment"
        if float(step.line.signed_distance(np.asarray(point))) < LEAST_FLAP:
            return f"the grasp is less than {1e3 * LEAST_FLAP:.0f} mm from the fold line, or beyond it"
    if edit.variant:
        variants = [v.name for v in plan.garment.plan[fold.index].variants]
        if edit.variant not in variants:
            return f"this fold has no variant {edit.variant}"
        if edit.variant == step.variant:
            return "this variant is planned already"
    return None


def with_plan_edit(context: RunContext, edit: PlanEdit) -> RunContext:
    """Return the context with one more edit of the present fold."""
    fold = context.fold
    changes: FoldContext = replace(fold, edits=with_edit(fold.edits, edit), refused_edit="")
    if edit.other_arc:
        changes = replace(changes, adjustments=_other_arc(fold))
    if edit.variant:
        changes = replace(changes, avoided=())
    return replace(context, fold=changes)


def without_edits(context: RunContext, why: str) -> RunContext:
    """Return the context without the edits of the present fold, because they cannot be made."""
    arcs = {Adjustment.OPTIMISE, Adjustment.PLAIN_ARC}
    kept = tuple(a for a in context.fold.adjustments if a not in arcs)
    return replace(context, fold=replace(context.fold, edits=(), refused_edit=why, adjustments=kept), failure=None)


def edited_state(state: GarmentState, edits: Sequence[PlanEdit]) -> GarmentState:
    """Return the flat garment with the key points where the operator has put them."""
    moved = {name: frozen(np.array(point)) for edit in edits for name, point in edit.keypoints.items()}
    return replace(state, keypoints={**state.keypoints, **moved}) if moved else state


def edited_variant(edits: Sequence[PlanEdit]) -> str | None:
    """Return the variant that the operator has chosen last, or None."""
    return next((edit.variant for edit in reversed(edits) if edit.variant), None)


def edited_step(step: FoldStep, edits: Sequence[PlanEdit]) -> FoldStep:
    """Return the step with the grasps where the operator has put them. A target moves like the mirror image of its
    grasp."""
    grasps, targets = dict(step.grasps), dict(step.targets)
    for edit in edits:
        for grasp_id, point in edit.grasps.items():
            if grasp_id not in grasps:
                continue
            before, now = grasps[grasp_id].point, np.asarray(point)
            shift = step.line.reflect(now) - step.line.reflect(before)
            grasps[grasp_id] = replace(grasps[grasp_id], point=frozen(now))
            targets[grasp_id] = frozen(targets[grasp_id] + np.append(shift, 0.0))
    return replace(step, grasps=grasps, targets=targets)


def _other_arc(fold: FoldContext) -> tuple[Adjustment, ...]:
    """Return the adjustments with which another arc is chosen: from the library, optimised, the initial arc, and
    again from the library."""
    arcs = {Adjustment.OPTIMISE, Adjustment.PLAIN_ARC}
    kept = tuple(a for a in fold.adjustments if a not in arcs)
    if Adjustment.PLAIN_ARC in fold.adjustments:
        return kept
    library = fold.attempt is not None and fold.attempt.trajectory.source == "library"
    return (*kept, Adjustment.OPTIMISE if library else Adjustment.PLAIN_ARC)
