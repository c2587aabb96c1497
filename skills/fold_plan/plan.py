"""Computes the fold steps (line, grasps, targets) from the garment's state and the plan of its file."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from foldcell.skills import plane
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.fold_plan.folding import fold_xy, layers_at, layers_under, nearest_moving, silhouette
from foldcell.skills.garments.garment import Garment, PlanGrasp, PlanStep, PlanVariant
from foldcell.skills.vocabulary import (
    Array,
    Failure,
    FailureKind,
    FoldLine,
    FoldStep,
    GarmentState,
    Grasp,
    GraspId,
    Outcome,
    frozen,
    refuse,
    skill,
)

RELEASE_CLEARANCE = 0.005
"""Height of the fingertips above the stack at release [m]. Tips that press into the stack would push it away."""

LEAST_FLAP = 0.02
"""Minimum width of the moving and of the remaining part of a fold [m]: two pads have to fit on each."""

GRASP_INSIDE = 0.010
"""A grasp that is moved onto the cloth lies this far inside its edge [m]."""

GRASP_SHIFT = 0.040
"""Maximum distance by which a grasp is moved onto the cloth [m]. A grasp that is farther off is a mistake."""

IN_LINE = 0.5
"""Two grasps are in line along x when they differ in y by less than this share of their distance."""


@skill
def plan_folds(
    state: GarmentState,
    garment: Garment,
    variants: Mapping[str, str] | None = None,
    pads: PadGeometry | None = None,
) -> Outcome[tuple[FoldStep, ...]]:
    """Compute the fold steps of a flat garment.

    state: the flat garment before its first fold, whichever steps are still to be made; the places of later steps
    are computed from the earlier folds. After a drift, move the plan with `translate_plan`. variants: step name ->
    name of the variant to use in place of the first variant (when an arm cannot reach). pads: the width and the
    stroke of the pads determine which layers a hand finds; None: the default pads.

    Fails with CATEGORY_MISMATCH when the garment is of another category; with LOW_CONFIDENCE when key points are
    missing or do not span the fold line, or when the line does not divide the garment that the earlier folds
    leave. Raises ValueError for an unknown variant.
    """
    refuse(_mismatch(state, garment))
    lines: list[FoldLine] = []
    steps: list[FoldStep] = []
    for index, step in enumerate(garment.plan):
        variant = _variant(step, (variants or {}).get(step.name))
        line = _fold_line(step, variant, state.keypoints)
        if line is None:
            return Outcome(
                failure=Failure(
                    FailureKind.LOW_CONFIDENCE,
                    f"the key points leave no fold line for step {step.name}",
                    "look again; smooth the garment if this repeats",
                    {"step": step.name},
                )
            )
        refuse(_missed(step, line, lines, state.keypoints, garment))
        earlier = tuple(lines)
        steps.append(_fold_step(step, variant, index, line, earlier, state, garment, pads or PadGeometry()))
        lines.append(line)
    return Outcome(tuple(steps), notes={"steps": len(steps)})


def translate_plan(
    steps: Sequence[FoldStep], offset: Array, rotation: float = 0.0, about: Array | None = None
) -> tuple[FoldStep, ...]:
    """Return the same steps for a garment that has drifted: rotated by `rotation` [rad] about `about` (2,), then
    moved by `offset` (2,) [m].

    The lines of the earlier steps are moved too. To compute the target shape of a moved step, move the mesh's rest
    coordinates in the same way.
    """
    centre = np.zeros(2) if about is None else np.asarray(about, dtype=float)

    def move(xy: Array) -> Array:
        return frozen(rigid_motion(xy, offset, rotation, centre))

    def move_line(line: FoldLine) -> FoldLine:
        return FoldLine(move(line.point), frozen(rigid_motion(line.direction, np.zeros(2), rotation, np.zeros(2))))

    def move_step(step: FoldStep) -> FoldStep:
        grasps = {
            grasp_id: replace(g, point=move(g.point), heading=_fold_angle(g.heading + rotation))
            for grasp_id, g in step.grasps.items()
        }
        targets = {grasp_id: frozen(np.append(move(t[:2]), t[2])) for grasp_id, t in step.targets.items()}
        earlier = tuple(move_line(line) for line in step.earlier)
        return replace(step, line=move_line(step.line), earlier=earlier, grasps=grasps, targets=targets)

    return tuple(move_step(step) for step in steps)


def ways_to_fold(garment: Garment, keypoints: Mapping[str, Array]) -> tuple[tuple[FoldLine, ...], ...]:
    """Return the fold lines for each combination of variants of the plan's steps, the preferred combination
    first."""
    outline = np.array([keypoints[name] for name in garment.keypoints])
    state = GarmentState(garment.category, outline, keypoints, confidence=1.0)
    choices = [[(step.name, v.name) for v in step.variants] for step in garment.plan]
    return tuple(plan_folds(state, garment, dict(way)).unwrap()[-1].lines for way in itertools.product(*choices))


def rigid_motion(xy: Array, offset: Array, rotation: float, about: Array) -> Array:
    """Rotate points (..., 2) by `rotation` [rad] about `about` (2,), then move them by `offset` (2,) [m]."""
    return (np.asarray(xy) - about) @ plane.rotation(-rotation) + about + np.asarray(offset)


def _mismatch(state: GarmentState, garment: Garment) -> Failure | None:
    if state.category != garment.category:
        return Failure(
            FailureKind.CATEGORY_MISMATCH,
            f"a {state.category} lies on the table, {garment.name} is a {garment.category}",
            "lay the garment that was named, or name the one that lies there",
            {"seen": state.category, "expected": garment.category},
        )
    missing = [name for name in garment.keypoints if name not in state.keypoints]
    if missing:
        return Failure(
            FailureKind.LOW_CONFIDENCE,
            f"key points not found: {', '.join(missing)}",
            "look again; smooth the garment if this repeats",
            {"missing": missing},
        )
    return None


def _missed(
    step: PlanStep, line: FoldLine, earlier: Sequence[FoldLine], keypoints: Mapping[str, Array], garment: Garment
) -> Failure | None:
    """Return a failure if less than LEAST_FLAP of the folded garment lies on one side of the line."""
    away = line.signed_distance(silhouette(earlier, np.array([keypoints[name] for name in garment.keypoints])))
    least = float(min(away.max(), -away.min()))
    if least >= LEAST_FLAP:
        return None
    where = f"misses it by {-1e3 * least:.0f} mm" if least < 0 else f"cuts off {1e3 * least:.0f} mm of it"
    folded = " as the earlier folds leave it" if earlier else ""
    return Failure(
        FailureKind.LOW_CONFIDENCE,
        f"the line of step {step.name} does not divide the garment{folded}: it {where}",
        f"a fold line leaves at least {1e3 * LEAST_FLAP:.0f} mm of the garment on either side",
        {"step": step.name, "least_m": least},
    )


def _variant(step: PlanStep, name: str | None) -> PlanVariant:
    if name is None:
        return step.variants[0]
    for variant in step.variants:
        if variant.name == name:
            return variant
    known = ", ".join(v.name for v in step.variants)
    raise ValueError(f"step {step.name} has no variant {name!r}, but {known}")


def _fold_line(step: PlanStep, variant: PlanVariant, keypoints: Mapping[str, Array]) -> FoldLine | None:
    """Return the fold line, directed so that the moving key points lie to its left; None if they lie on both
    sides, or if its two anchors nearly coincide."""
    a, b = (anchor.on(keypoints) for anchor in step.line)
    length = float(np.linalg.norm(b - a))
    if length < 0.02:
        return None
    line = FoldLine(frozen(a), frozen((b - a) / length))
    d = np.array([line.signed_distance(keypoints[name]) for name in variant.moves])
    if abs(np.sign(d).sum()) != len(d):
        return None
    return line if d[0] > 0 else FoldLine(frozen(b), frozen((a - b) / length))


def _fold_step(
    step: PlanStep,
    variant: PlanVariant,
    index: int,
    line: FoldLine,
    earlier: tuple[FoldLine, ...],
    state: GarmentState,
    garment: Garment,
    pads: PadGeometry,
) -> FoldStep:
    outline = np.array([state.keypoints[name] for name in garment.keypoints])
    middle = _middle_of_moving(line, silhouette(earlier, outline))
    points = [
        _on_cloth(_grasp_point(g, line, earlier, state.keypoints, middle), line, earlier, outline)
        for g in variant.grasps
    ]
    grasp_ids = _grasp_ids(variant.grasps, points)
    grasps: dict[GraspId, Grasp] = {}
    targets: dict[GraspId, Array] = {}
    for plan, point, i in sorted(zip(variant.grasps, points, grasp_ids, strict=True), key=lambda t: t[2].value):
        heading = _fold_angle(float(np.arctan2(line.direction[1], line.direction[0])) + plan.turn)
        layers = max(
            layers_under(earlier, outline, _footprint(point, heading, pads), garment.layers), garment.layers
        )
        height = layers * garment.material.thickness
        grasps[i] = Grasp(frozen(point), heading, layers, height)
        landing = _landing(step, line, point, points)
        # Layers are counted at the mirror image: tension can move the release point just past the cloth's edge.
        below = layers_at(earlier, outline, line.reflect(point), garment.layers) * garment.material.thickness
        targets[i] = frozen(np.array([*landing, below + RELEASE_CLEARANCE]))
    return FoldStep(step.name, index, line, earlier, grasps, targets, variant.name)


def _footprint(point: Array, heading: float, pads: PadGeometry) -> Array:
    """Return the corners (4, 2) [m] of the area of the open pads: their width along `heading`, the direction of
    the cloth that they will hold, and their stroke perpendicular to it."""
    along = 0.5 * pads.width * np.array([np.cos(heading), np.sin(heading)])
    across = 0.5 * pads.stroke * np.array([-np.sin(heading), np.cos(heading)])
    return point + np.array([along + across, along - across, -along - across, across - along])


def _landing(step: PlanStep, line: FoldLine, point: Array, points: Sequence[Array]) -> Array:
    """Return the release point (2,) of a grasp: the mirror image of the grasp point, shifted by the step's
    tension."""
    past, apart = step.tension
    along = float((point - np.mean(points, axis=0)) @ line.direction)
    return line.reflect(point) - past * line.normal + apart * np.sign(round(along, 6)) * line.direction


def _middle_of_moving(line: FoldLine, outline: Array) -> float:
    """Position of the moving part's middle along the fold line [m], measured from the line's point."""
    along = (outline - line.point) @ line.direction
    moving = along[line.signed_distance(outline) > 0]
    return float((moving.min() + moving.max()) / 2)


def _grasp_point(
    grasp: PlanGrasp, line: FoldLine, earlier: tuple[FoldLine, ...], keypoints: Mapping[str, Array], middle: float
) -> Array:
    at = fold_xy(earlier, grasp.at.on(keypoints))
    along = float((at - line.point) @ line.direction)
    across, inwards = grasp.inset
    return at - across * line.normal + np.sign(middle - along) * inwards * line.direction


def _on_cloth(point: Array, line: FoldLine, earlier: tuple[FoldLine, ...], outline: Array) -> Array:
    """Return the grasp point (2,), moved onto the moving part if it lies beside it or too near to the line. An
    inset that suits the sleeve of one shirt leads beside the sleeve of another, which droops."""
    moved = nearest_moving(line, earlier, outline, point, LEAST_FLAP, GRASP_INSIDE)
    return moved if float(np.linalg.norm(moved - point)) <= GRASP_SHIFT else point


def _grasp_ids(grasps: Sequence[PlanGrasp], points: Sequence[Array]) -> list[GraspId]:
    """Return the ids that the plan states for the grasps. If it states none, choose them by position. The left
    grasp is the one with the larger y. If the two grasps are in line along x (IN_LINE), the left one is the one
    farther from the robot."""
    named = [g.grasp_id for g in grasps]
    if len(named) == 1:
        return [named[0] or (GraspId.LEFT if points[0][1] >= 0 else GraspId.RIGHT)]
    for own, other in ((0, 1), (1, 0)):
        if named[own] is None and (fixed := named[other]) is not None:
            named[own] = fixed.other
    if named[0] is not None and named[1] is not None:
        return [named[0], named[1]]
    dx, dy = points[0] - points[1]
    first_left = dx > 0 if abs(dy) < IN_LINE * np.hypot(dx, dy) else dy > 0
    return [GraspId.LEFT, GraspId.RIGHT] if first_left else [GraspId.RIGHT, GraspId.LEFT]


def _fold_angle(angle: float) -> float:
    """Reduce the angle [rad] of an undirected line to (-60, 120] degrees. The ends of this interval are away from
    both axes, so small errors of a line along an axis do not make the angle jump."""
    return float(np.pi * 2 / 3 - (np.pi * 2 / 3 - angle) % np.pi)
