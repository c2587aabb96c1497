"""Finds a corner of the upper layers that lies turned back on the garment.

Such a corner changes neither the outline nor the mean height of many cells, so that the comparison of whole shapes
overlooks it. It leaves the lower layers bare, and its mirror image in the crease is higher by as much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from foldcell.skills.perception.inspection.predicted_view import draw_shape
from foldcell.skills.plane import rotation
from foldcell.skills.state_estimate.estimate import StateEstimate
from foldcell.skills.state_estimate.hypothesis import FoldState, Hypothesis, Interruption
from foldcell.skills.state_estimate.observation import Observation
from foldcell.skills.vocabulary import Array, FoldLine, Grasp, GraspId, frozen

REACH = 0.15
"""The bare corner lies within this distance of the grasp [m]."""
DEPTHS = np.arange(0.020, 0.100, 0.004)
"""Distances between the corner and its crease [m]. Two pads do not fit on a smaller one."""
DIRECTIONS = np.deg2rad(np.arange(0.0, 360.0, 6.0))
"""Directions of the crease [rad]."""
SPACING = 2
"""Every so many pixels of the view are compared, in each direction."""
LEAST_STEP = 0.002
"""The camera does not show a smaller step: it sees flat cloth up to half as much too high or too low [m]."""
SHOWN = 0.4
"""Least mean of `_shows` in the bare corner, and in its mirror image. The camera does not see into the crease."""


def with_turned_corner(
    found: StateEstimate, seen: Observation, grasps: Mapping[GraspId, Grasp], thickness: float
) -> StateEstimate:
    """Correct an estimate that the garment lies as before the fold, if a corner of the upper layers lies turned
    back at a grasp. Any other estimate is returned unchanged.

    grasps: those of the fold, where the garment lay before it. thickness: of a layer [m].
    """
    best = found.best
    stacks = {i: grasp for i, grasp in grasps.items() if grasp.layers > 1}
    if best is None or found.state is not FoldState.BEFORE or not stacks:
        return found
    raised = np.asarray(seen.height - draw_shape(seen.view, best.shape), dtype=float)
    raised -= np.nanmedian(raised[seen.mask])
    places = {i: best.placed(np.append(grasp.point, 0.0)[None])[0, :2] for i, grasp in stacks.items()}
    ways = [(i, upper) for i, grasp in stacks.items() for upper in range(1, grasp.layers)]
    creases = [_crease(seen, raised, places[i], upper * thickness) for i, upper in ways]
    (_, crease), (turned, upper) = max(zip(creases, ways, strict=True), key=lambda pair: pair[0][0])
    if crease is None:
        return found
    now = best.taken_back(turned_back(best.shape.vertices, crease, stacks[turned].layers, upper, thickness))
    shape = replace(best.hypothesis.shape, vertices=now)
    fit = replace(best, hypothesis=Hypothesis(FoldState.HALF_WAY, shape, Interruption(turned=turned)))
    other = {FoldState.BEFORE: FoldState.HALF_WAY, FoldState.HALF_WAY: FoldState.BEFORE}
    probabilities = {state: found.probabilities[other.get(state, state)] for state in FoldState}
    return replace(found, state=FoldState.HALF_WAY, best=fit, fits=(fit, *found.fits), probabilities=probabilities)


def turned_back(vertices: Array, line: FoldLine, layers: int, upper: int, thickness: float) -> Array:
    """Return a stack of `layers` layers, vertices (n, 3), with the corner of its `upper` layers turned back over a
    line. The corner lies on the moving side. thickness: of a layer [m]."""
    turns = (line.signed_distance(vertices[:, :2]) > 0.0) & (vertices[:, 2] > (layers - upper) * thickness)
    xy = np.where(turns[:, None], line.reflect(vertices[:, :2]), vertices[:, :2])
    z = np.where(turns, 2.0 * layers * thickness - vertices[:, 2], vertices[:, 2])
    return frozen(np.column_stack([xy, z]))


def _crease(seen: Observation, raised: Array, grasp: Array, step: float) -> tuple[float, FoldLine | None]:
    """Return the area in which a crease near a grasp (2,) explains the heights [m2], and this crease; None if none
    does. raised: (H, W) heights above those before the fold [m], NaN where unknown. step: of the turned layers
    [m]."""
    best: tuple[float, FoldLine | None] = 0.0, None
    if step < LEAST_STEP:
        return best
    rows, columns = SPACING * np.array(np.nonzero(seen.mask[::SPACING, ::SPACING]))
    points = seen.view.to_table(np.column_stack([columns, rows]))
    lower = _shows(-raised[rows, columns], step)
    higher = np.where(seen.mask, _shows(raised, step), -1.0)
    near = np.linalg.norm(points - grasp, axis=1) < REACH
    for angle in DIRECTIONS:
        direction = rotation(angle)[:, 0]
        normal = FoldLine(grasp, direction).normal
        out = points @ normal
        for depth in DEPTHS:
            line = FoldLine(frozen((out.max() - depth) * normal), frozen(direction))
            bare = line.signed_distance(points) > 0.0
            if not near[bare].all():
                break
            pixels = np.round(seen.view.to_pixel(line.reflect(points[bare]))).astype(int)
            column, row = np.clip(pixels, 0, np.array(seen.mask.shape[::-1]) - 1).T
            shown = lower[bare], higher[row, column]
            area = float(sum(part.sum() for part in shown)) * (SPACING * seen.view.pixel) ** 2
            if min(part.mean() for part in shown) >= SHOWN and area > best[0]:
                best = area, line
    return best


def _shows(change: Array, step: float) -> Array:
    """Return how well changes of height [m] show a step: 1 for the whole step, -1 for none, 0 if unknown. A larger
    change shows no more, apart from noise."""
    return np.nan_to_num(np.clip(2.0 * change / step - 1.0, -1.0, 1.5))
