"""Plans the repair of a half-made fold. The hands grasp the moved edge where it lies now. They carry it back to
where it lay before the fold, or on to the target of the fold.

The hands take the material that they held in the fold. Its present place and direction follow from the believed
shapes before the fold and now. Both shapes have the same vertices.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import Patch
from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE
from foldcell.skills.plane import barycentric
from foldcell.skills.vocabulary import (
    Array,
    Failure,
    FailureKind,
    FoldLine,
    FoldStep,
    Grasp,
    GraspId,
    Outcome,
    frozen,
)


class RepairGoal(StrEnum):
    """Where the moved cloth is carried."""

    UNDO = "undo"  # back where it lay before the fold
    COMPLETE = "complete"  # on to the target of the fold


_DONE = {RepairGoal.UNDO: "undone", RepairGoal.COMPLETE: "completed"}

MISPLACED: Mapping[RepairGoal, float] = {RepairGoal.UNDO: 0.030, RepairGoal.COMPLETE: 0.015}
"""A hand takes part only if the material of its grasp lies at least this far from where it has to lie [m]. A
garment that is folded anew may lie less exactly than one whose fold is completed."""
REACH = 0.015
"""Standard deviation of the weights with which the vertices near a grasp determine its present place [m]."""
SMOOTH = 0.6
"""Cloth whose grasped line appears shorter than this share from above is rumpled or stands on edge."""
COVERED = 0.3
"""Cloth counts as covered if the middle of a layer lies higher than its top by this share of a thickness. The
middle of the next layer lies half a thickness higher."""
OWN = (0.010, 0.040)
"""Cloth counts as the grasped cloth if it lay near the grasp before the fold: nearer than half the distance by
which the grasped cloth has moved, limited to this range [m]. Cloth that stayed and now lies below the grasped
cloth is as far from the grasp as the grasped cloth has moved."""
STAYED, LEFT_BEHIND, ABOVE = 0.010, 0.2, 0.25
"""Cloth has stayed if it moved by less than this [m]. If at least this share of the cloth near a grasp has stayed,
and as much has moved, and lay higher by this share of a thickness, on average, only the upper layers have moved.
Beside a small flap of all layers, cloth of all layers has stayed."""
INWARD, CLOSER = 0.030, 0.25
"""Other places at which the hands may hold the moved cloth: further from its edge [m], or nearer to each other, as
a share of their distance."""


@dataclass(frozen=True, eq=False)
class RepairPlan:
    """goal: where the moved cloth is carried. step: the repair as a fold step: grasps where this cloth lies now,
    targets where it has to lie. headings: for each hand, the heading of the held line at the grasp and at the
    target [rad]; the hand turns from one to the other.

    patches: the cloth that each hand is to take. A real hand counts the layers between its pads before it lifts
    them, and opens if it finds other layers than planned. In a simulation, layers of the stack below may stand up
    between the grasped layers, for example beside the crease of an earlier fold. A single held point of such a
    layer would drag the whole stack along. Therefore the hands of a prediction take the cloth of the patch
    alone.

    thickness: of a layer, from which the heights of the grasps follow [m]."""

    goal: RepairGoal
    step: FoldStep
    headings: Mapping[GraspId, tuple[float, float]]
    patches: Mapping[GraspId, Patch]
    thickness: float


def plan_repair(
    goal: RepairGoal,
    mesh: ClothMesh,
    before: Array,
    now: Array,
    step: FoldStep,
    thickness: float,
    stated: float | None = None,
) -> Outcome[RepairPlan]:
    """Plan the repair of a fold that is half made.

    before, now: (n, 3) believed vertices before the fold and now, table frame [m]. step: the fold. If the garment
    was displaced as a whole, `before` and `step` are displaced in the same way. thickness: of a layer [m];
    stated: the one with which the step was planned, if another. Only the hands whose cloth is MISPLACED take part.

    Fails with HALF_FOLDED if the cloth of no grasp is misplaced, or if misplaced cloth lies under other cloth or
    is rumpled. If only the upper layers of a grasp have moved, they can be laid back, but not carried on.
    """
    grasps: dict[GraspId, Grasp] = {}
    targets: dict[GraspId, Array] = {}
    headings: dict[GraspId, tuple[float, float]] = {}
    patches: dict[GraspId, Patch] = {}
    for grasp_id, grasp in step.grasps.items():
        moved, layers = _moved_layers(before, now, grasp, thickness)
        if goal is RepairGoal.COMPLETE and layers < grasp.layers:
            return Outcome(failure=_impossible(goal, step, "only its upper layers have moved"))
        place, heading, smooth = locate_grasp(before[moved], now[moved], grasp)
        target = _target(goal, step, grasp_id, thickness, stated or thickness)
        target = frozen(target + np.array([0.0, 0.0, (grasp.layers - layers) * thickness]))
        grasp = replace(grasp, layers=layers)
        if float(np.linalg.norm(place[:2] - target[:2])) < MISPLACED[goal]:
            continue
        top = float(place[2]) + 0.5 * grasp.layers * thickness
        name = f"the cloth of the {grasp_id.value} grasp"
        if smooth < SMOOTH:
            return Outcome(failure=_impossible(goal, step, f"{name} is rumpled"))
        patch = _grasped_cloth(before, grasp.point, place[:2])
        others = _other_layers(mesh, now, patch, place[:2])
        if (others > top + COVERED * thickness).any():
            return Outcome(failure=_impossible(goal, step, f"{name} lies under other cloth"))
        # the tips press lofty cloth down to the layers below it
        height = (len(others) + grasp.layers) * thickness
        grasps[grasp_id] = replace(grasp, point=frozen(place[:2]), heading=heading, height=height)
        targets[grasp_id] = target
        headings[grasp_id] = heading, grasp.heading
        patches[grasp_id] = patch
    if not grasps:
        return Outcome(failure=_impossible(goal, step, "the cloth of every grasp lies where it should"))
    line = step.line if goal is RepairGoal.COMPLETE else FoldLine(step.line.point, frozen(-step.line.direction))
    named = replace(step, name=f"{goal.value} {step.name}", line=line, grasps=grasps, targets=targets)
    return Outcome(RepairPlan(goal, named, headings, patches, thickness))


def ways_to_hold(step: FoldStep) -> Iterator[tuple[str, FoldStep]]:
    """Yield the ways in which the hands may hold the cloth of a fold to repair it, in words and as the fold with
    these grasps: as in the fold (without words), then further from the edge; two hands also nearer to each other,
    and either hand alone."""
    yield "", step
    inward = {grasp_id: -INWARD * step.line.normal for grasp_id in step.grasps}
    yield "further from the edge", _shifted(step, inward)
    if len(step.grasps) == 2:
        (first, a), (second, b) = step.grasps.items()
        apart = CLOSER * (b.point - a.point)
        yield "nearer to each other", _shifted(step, {first: apart, second: -apart})
        for grasp_id in step.grasps:
            alone = {grasp_id: step.grasps[grasp_id]}, {grasp_id: step.targets[grasp_id]}
            yield f"with the {grasp_id.value} grasp alone", replace(step, grasps=alone[0], targets=alone[1])


def _shifted(step: FoldStep, shifts: Mapping[GraspId, Array]) -> FoldStep:
    """Return the fold with each grasp moved by its shift (2,) [m], and each target as the fold moves its cloth."""
    normal = step.line.normal
    mirrored = {i: shift - 2.0 * float(shift @ normal) * normal for i, shift in shifts.items()}
    grasps = {i: replace(g, point=frozen(g.point + shifts[i])) for i, g in step.grasps.items()}
    targets = {i: frozen(t + np.append(mirrored[i], 0.0)) for i, t in step.targets.items()}
    return replace(step, grasps=grasps, targets=targets)


def _target(goal: RepairGoal, step: FoldStep, grasp_id: GraspId, thickness: float, stated: float) -> Array:
    """Return where a hand releases its cloth (3,) [m]."""
    if goal is RepairGoal.COMPLETE:
        return step.targets[grasp_id]
    grasp = step.grasps[grasp_id]
    below = max(grasp.height / stated - grasp.layers, 0.0) * thickness
    return frozen(np.append(grasp.point, below + RELEASE_CLEARANCE))


def _moved_layers(before: Array, now: Array, grasp: Grasp, thickness: float) -> tuple[NDArray[np.bool_], int]:
    """Return which vertices (n,) tell where the grasped cloth has gone, and how many of the grasped layers went
    there: only the upper ones, if others have stayed. before, now: (n, 3) vertices [m]; thickness: of a layer
    [m]."""
    near = np.linalg.norm(before[:, :2] - grasp.point, axis=1) < OWN[1]
    stayed = np.linalg.norm(now - before, axis=1) < STAYED
    share = float(stayed[near].mean()) if near.any() else 0.0
    partly = grasp.layers > 1 and min(share, 1.0 - share) >= LEFT_BEHIND
    height, others = (before[near & part, 2] for part in (~stayed, stayed))
    if not partly or height.mean() - others.mean() < ABOVE * thickness:
        return np.ones(len(before), dtype=bool), grasp.layers
    return ~stayed, int(np.clip(round(grasp.layers * (1.0 - share)), 1, grasp.layers - 1))


def locate_grasp(before: Array, now: Array, grasp: Grasp) -> tuple[Array, float, float]:
    """Return three values of a grasped line: the present place (3,) of its middle [m]; its present heading [rad],
    within a quarter turn of its heading before the fold; its present length seen from above, relative to its
    length before the fold.

    They follow from the affine map that best fits the motion of the vertices near the grasp. Vertices that are
    farther from the grasp have less weight. before, now: (n, 3) vertices [m].
    """
    offset = before[:, :2] - grasp.point
    squared = (offset**2).sum(axis=1)
    # on a coarse mesh, the standard deviation is the distance of the sixth nearest vertex
    reach = max(REACH, float(np.sqrt(np.partition(squared, 5)[5])) if len(squared) > 5 else REACH)
    weight = np.exp(-0.5 * squared / reach**2)
    root = np.sqrt(weight)[:, None]
    terms = np.column_stack([np.ones(len(offset)), offset])
    affine, *_ = np.linalg.lstsq(root * terms, root * now, rcond=None)
    direction = np.array([np.cos(grasp.heading), np.sin(grasp.heading)])
    along = direction @ affine[1:, :2]
    along = along if along @ direction >= 0.0 else -along
    turn = float(np.arctan2(direction[0] * along[1] - direction[1] * along[0], direction @ along))
    return affine[0], grasp.heading + turn, float(np.linalg.norm(along))


def _grasped_cloth(before: Array, grasp: Array, place: Array) -> Patch:
    """Return the cloth that lay near a grasp (2,) before the fold, and now lies at a place (2,) [m]. OWN limits
    its radius."""
    reach = float(np.clip(0.5 * np.linalg.norm(place - grasp), *OWN))
    return Patch(frozen(before[:, :2]), frozen(grasp), reach)


def _other_layers(mesh: ClothMesh, now: Array, grasped: Patch, point: Array) -> Array:
    """Return the heights (k,) [m] at which other cloth than the grasped cloth lies at a point (2,). The grasped
    cloth itself may be lofty, for example beside the crease of an earlier fold."""
    weights = barycentric(now[mesh.triangles][..., :2], point)
    over = (weights >= 0.0).all(axis=1)
    weights, corners = weights[over], mesh.triangles[over]
    heights = np.einsum("kc,kc->k", weights, now[corners][..., 2])
    other = ~grasped.contains(corners, weights)
    return np.unique(np.round(heights[other], 6))  # a point on an edge lies on two triangles of one layer


def _impossible(goal: RepairGoal, step: FoldStep, why: str) -> Failure:
    return Failure(
        FailureKind.HALF_FOLDED,
        f"fold {step.name} cannot be {_DONE[goal]}: {why}",
        "lay the garment as it was before this fold (its outline is in the report), then retry",
    )
