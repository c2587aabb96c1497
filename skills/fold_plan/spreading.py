"""Plans a pull that spreads a garment of which nothing is known but its silhouette: a heap, or cloth that lies
under other cloth (quasi-static smoothing or flattening of fabric by pulling its corners: Seita et al. 2020; Sun et
al. 2015). It needs no mesh, no simulation and no hypothesis about the folds of the cloth.

Corners of the silhouette are taken for corners of the garment. A corner that lies where the flat garment has one
is left alone and holds the garment by its friction. The other corners are pulled to the places at which no corner
lies, slowly and low over the table, two at a time if possible, so that they also pull against each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.skills.fold_plan.plan import RELEASE_CLEARANCE
from foldcell.skills.vocabulary import (
    Array,
    Corner,
    Failure,
    FailureKind,
    FoldLine,
    FoldStep,
    Grasp,
    GraspId,
    Outcome,
    Table,
    frozen,
)

__all__ = ["AWAY", "Pull", "plan_pulls", "pulls_home", "spread_arcs", "spread_step"]

AWAY = 0.030
"""A corner that lies nearer than this to its place counts as lying there [m]. Recognition moves the plan by as
much, and a garment that is folded anew may lie as inexactly (`skills/fold_plan/repair.py`)."""
LONGEST = 0.35
"""Longest pull [m]. If a corner of a heap lies further than this from a place, it is uncertain whether it belongs
there. A corner that is pulled to a wrong place would fold the garment over."""
STRETCH = 0.02
"""Two corners of a garment lie at most as far apart as in the flat garment. This tolerance is added for the errors
of both corners [m]."""
APART = 0.10
"""Least distance between the two grasps and between their targets [m], so that the hands do not meet."""
MARGIN = 0.05
"""Least distance of a grasp, of a target, and of the spread garment from the table's edge [m]."""
INSET = 0.018
"""Distance of a grasp from the tip of its corner, along the bisector [m]: 13 mm from both edges of a right angle,
as in the plans of the garment files."""
HEIGHT = 0.05
"""Height of the tips in the middle of a pull [m]: cloth beside a lifted corner slides, and the rest of the garment
stays on the table and holds it."""


@dataclass(frozen=True, eq=False)
class Pull:
    """The path of one hand in a pull. grasp, target: (2,) middle of the held line at its start and at its end
    [m]."""

    grasp: Array
    target: Array

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.target - self.grasp))


@dataclass(frozen=True, eq=False)
class _Match:
    """A corner of the silhouette and the index of the place to which it may belong. away: distance of the corner
    from this place [m]."""

    corner: Corner
    place: int
    away: float


def plan_pulls(
    contour: Array,
    corners: Sequence[Corner],
    places: Sequence[Corner],
    table: Table,
    takeable: Callable[[Array], bool],
) -> Outcome[tuple[Pull, ...]]:
    """Choose one or two corners of a silhouette and pull them to the places of the garment's corners.

    contour: (n, 2) boundary of the silhouette [m]. corners: corners of this boundary. places: where the corners of
    the garment would lie if it were spread. table: its edges bound the pulls. takeable: whether a hand can take
    all cloth at a point (2,).

    A pull may drag the whole heap along. Therefore a pull that would drag the heap over the table's edge is not
    planned. Of all pairs of corners that can be pulled at once, the pair that is nearest to its places is chosen,
    because it is the least doubtful. Fails with HEAPED, with the reason, if no corner can be pulled.
    """
    if not all(_on(table, place.point) for place in places):
        return Outcome(failure=_impossible("it would reach over the table's edge"))
    held = [k for k, place in enumerate(places) if _nearest(place, corners) < AWAY]
    missing = [k for k in range(len(places)) if k not in held]
    loose = [c for c in corners if _nearest(c, places) >= AWAY]
    if not missing:
        return Outcome(failure=_impossible("every corner lies in its place, and the cloth between them does not"))
    if not loose:
        return Outcome(failure=_impossible("no corner of its outline can be told from cloth that lies in place"))
    within = [c for c in loose if takeable(_grasp(c)) and _on(table, _grasp(c))]
    if not within:
        return Outcome(failure=_impossible("no hand can take all cloth at a corner of its outline"))
    matches = [
        _Match(corner, k, away)
        for corner, k in itertools.product(within, missing)
        if AWAY <= (away := _distance(corner, places[k])) <= LONGEST
        and all(_on(table, point) for point in contour + (_grasp(places[k]) - _grasp(corner)))
        and all(_distance(corner, places[h]) <= _distance(places[k], places[h]) + STRETCH for h in held)
    ]
    couples = [c for c in itertools.combinations(matches, 2) if _possible(*c, places)]
    chosen: Sequence[_Match] = min(couples, key=lambda c: c[0].away + c[1].away, default=())
    chosen = chosen or sorted(matches, key=lambda m: m.away)[:1]
    if not chosen:
        return Outcome(failure=_impossible("no corner of its outline has a place within reach to be pulled to"))
    return Outcome(tuple(Pull(_grasp(m.corner), _grasp(places[m.place])) for m in chosen))


def pulls_home(places: Sequence[Corner], home: Sequence[Corner], table: Table) -> Outcome[tuple[Pull, ...]]:
    """Plan the pull of a spread garment back to where it lay. Two hands pull its leading edge: the edge that faces
    the direction of the pull.

    places, home: corners of the garment now and before, in the same order around the garment. Fails with HEAPED if
    no edge leads, or if the pull would be too long or too near the table's edge.
    """
    here, there = (np.array([c.point for c in cs]) for cs in (places, home))
    way = (there - here).mean(axis=0)
    leading = []
    for k in range(len(here)):
        j = (k + 1) % len(here)
        edge = here[j] - here[k]
        outward = np.array([edge[1], -edge[0]]) @ way
        apart = min(np.linalg.norm(edge), np.linalg.norm(there[j] - there[k]))
        if outward > np.cos(np.pi / 4) * np.linalg.norm(edge) * np.linalg.norm(way) * 0.99 and apart >= APART:
            leading.append((float(apart), k, j))
    if not leading:
        return Outcome(failure=_impossible("no edge of it leads to where it lay"))
    _, *ends = max(leading)
    pulls = tuple(Pull(_grasp(places[k]), _grasp(home[k])) for k in ends)
    if not all(_on(table, p.grasp) and _on(table, p.target) and p.length <= LONGEST for p in pulls):
        return Outcome(failure=_impossible("it lies out of reach of where it lay"))
    return Outcome(pulls)


def spread_step(name: str, index: int, pulls: Sequence[Pull], thickness: float) -> FoldStep:
    """Return the pulls as a fold step, which the hands perform like a fold. They take all layers down to the
    table, at least one, with the held line across the pull. thickness: of a layer [m]. The fold line only marks
    the direction of the pull."""
    ordered = sorted(pulls, key=lambda p: -float(p.grasp[1]))
    ids = (GraspId.LEFT, GraspId.RIGHT) if len(ordered) == 2 else (_side(ordered[0]),)
    by_id = dict(zip(ids, ordered, strict=True))
    middle = np.mean([p.grasp for p in ordered], axis=0)
    way = np.mean([(p.target - p.grasp) / max(p.length, 1e-9) for p in ordered], axis=0)
    way = way / norm if (norm := float(np.linalg.norm(way))) > 1e-6 else np.array([1.0, 0.0])
    return FoldStep(
        name=f"spread {name}",
        index=index,
        line=FoldLine(frozen(middle), frozen(np.array([way[1], -way[0]]))),
        earlier=(),
        grasps={i: Grasp(frozen(p.grasp), _across(p), 1, thickness) for i, p in by_id.items()},
        targets={i: frozen(np.append(p.target, RELEASE_CLEARANCE)) for i, p in by_id.items()},
    )


def spread_arcs(step: FoldStep) -> Mapping[GraspId, Array]:
    """Return the control points (4, 3) of the pulls of a step: low over the table [m]."""
    arcs = {}
    for grasp_id, grasp in step.grasps.items():
        start, end = np.append(grasp.point, 0.0), step.targets[grasp_id]
        inner = [start + share * (end - start) for share in (1.0 / 3.0, 2.0 / 3.0)]
        arcs[grasp_id] = frozen(np.array([start, *(np.append(p[:2], HEIGHT) for p in inner), end]))
    return arcs


def _possible(a: _Match, b: _Match, places: Sequence[Corner]) -> bool:
    """Whether two corners can be pulled at once: both exist, cloth joins them, and the hands do not meet or
    cross."""
    if a.corner is b.corner or a.place == b.place:
        return False
    between, aim = a.corner.point - b.corner.point, places[a.place].point - places[b.place].point
    lengths = float(np.linalg.norm(between)), float(np.linalg.norm(aim))
    return min(lengths) >= APART and lengths[0] <= lengths[1] + STRETCH and float(between @ aim) > 0.0


def _distance(a: Corner, b: Corner) -> float:
    return float(np.linalg.norm(a.point - b.point))


def _nearest(corner: Corner, others: Sequence[Corner]) -> float:
    return min((_distance(corner, other) for other in others), default=np.inf)


def _grasp(corner: Corner) -> Array:
    return frozen(corner.point + INSET * corner.inward)


def _on(table: Table, point: Array) -> bool:
    return bool(
        table.x[0] + MARGIN <= point[0] <= table.x[1] - MARGIN
        and table.y[0] + MARGIN <= point[1] <= table.y[1] - MARGIN
    )


def _side(pull: Pull) -> GraspId:
    """Return the hand on whose side a single pull lies."""
    return GraspId.LEFT if pull.grasp[1] + pull.target[1] > 0.0 else GraspId.RIGHT


def _across(pull: Pull) -> float:
    """Return the heading of the held line, across the pull, within a quarter turn of table x [rad]."""
    way = pull.target - pull.grasp
    heading = float(np.arctan2(way[1], way[0])) + 0.5 * np.pi
    return float((heading + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def _impossible(why: str) -> Failure:
    return Failure(
        FailureKind.HEAPED,
        f"the garment cannot be spread: {why}",
        "lay the garment flat where it lay before this fold (its outline is in the report), then retry",
    )
