"""Plans a pull that spreads a garment of which nothing is known but its silhouette: a heap, or cloth that lies
under other cloth (quasi-static smoothing or flattening of fabric by pulling its corners: Seita et al. 2020; Sun et
al. 2015). It needs no mesh, no simulation and no hypothesis about the folds of the cloth.

Corners of the silhouette are taken for corners of the garment. A corner that lies where the flat garment has one
is left alone and holds the garment by its friction. The other corners are pulled to the places at which no corner
lies, slowly and low over the table, two at a time if possible, so that they also pull against each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

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

Possible = Callable[[Array], bool]
"""Whether cloth and hands may be at points (n, 2): on the table, and in the camera's view."""

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


OUTWARD = 0.25
"""Least share of a pull that leads away from the cloth beside the corner. A corner that is pulled into the cloth
heaps it up."""
FOLLOWS = 0.008
"""A boundary that lies nearer than this to an edge of the flat garment follows it [m]."""
LEAST_FOLLOWED = 0.3
"""It follows at least this share of each edge beside a corner that is folded over."""
LEAST_FLAP = 0.025
"""Least distance of the tip of a folded corner from its crease [m]."""
FINEST = 1e-7
"""Precision of the share of a pull at which it has to end."""
LEAST_GAP, WIDEST_GAP = 0.010, 0.120
"""A ruck draws the boundary in by at least this, the noise of pictures, and by at most this [m]. Behind a wider
gap, cloth lies folded over or under, and a boundary that is pulled drags it along."""


@dataclass(frozen=True, eq=False)
class Pull:
    """The path of one hand in a pull. grasp, target: (2,) middle of the held line at its start and at its end
    [m]. upper: whether the hand takes the upper of two layers only."""

    grasp: Array
    target: Array
    upper: bool = False

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.target - self.grasp))


@dataclass(frozen=True, eq=False)
class _Match:
    """A corner of the silhouette and the index of the place to which it may belong. order: index of the corner
    along the boundary; away: distance of the corner from this place [m]; pull: towards the place, as far as the
    table allows."""

    corner: Corner
    order: int
    place: int
    away: float
    pull: Pull


def plan_pulls(
    contour: Array,
    corners: Sequence[Corner],
    flat: Array,
    places: Sequence[Corner],
    possible: Possible,
    takeable: Callable[[Array], bool],
    fruitless: int = 0,
) -> Outcome[tuple[Pull, ...]]:
    """Choose one or two corners of a silhouette and pull them to the places of the garment's corners.

    contour: (n, 2) boundary of the silhouette [m]. corners: corners of this boundary. flat: (m, 2) where the
    outline of the garment would lie if it were spread [m], and places: its corners. possible: bounds the pulls.
    takeable: whether a hand can take all cloth at a point (2,). fruitless: number of pulls in a row that have
    not enlarged the covered area; as many of the best pulls are left out.

    A pull may drag the whole heap along. Therefore it ends before the heap could come to the table's edge or out
    of view, and another pull may go on from there. Corners belong to places in their order along the boundary. Of
    all pairs of corners that can be pulled at once, the pair that is nearest to its places is chosen, because it
    is the least doubtful. The other hand holds the garment behind a single pull. A corner that lies on the
    garment is unfolded first. A ruck between corners that lie in place is pulled out at the boundary. Fails with
    HEAPED, with the reason, if nothing can be pulled.
    """
    if not possible(np.array([place.point for place in places])):
        return Outcome(failure=_impossible("it would reach over the table's edge or out of the camera's view"))

    def free(point: Array) -> bool:
        return possible(point[None]) and takeable(point)

    held = [k for k, place in enumerate(places) if _nearest(place, corners) < AWAY]
    missing = [k for k in range(len(places)) if k not in held]
    loose = [i for i, c in enumerate(corners) if _nearest(c, places) >= AWAY]
    lying = [(min(range(len(corners)), key=lambda i: _distance(corners[i], places[h])), h) for h in held]
    flaps = tuple(_flaps(contour, places, missing, possible))
    within = [i for i in loose if free(_grasp(corners[i]))]
    matches = [
        _Match(corner, i, k, away, pull)
        for i, k in itertools.product(within, missing)
        if AWAY <= (away := _distance(corner := corners[i], places[k])) <= LONGEST
        and (pull := _pull(_grasp(corner), _grasp(places[k]), contour, possible)).length >= AWAY
        and float((places[k].point - corner.point) @ corner.inward) < -OUTWARD * away
        and all(_distance(corner, corners[c]) <= _distance(places[k], places[h]) + STRETCH for c, h in lying)
        and _in_order((*lying, (i, k)))
    ]
    couples = [
        (a, b) for a, b in itertools.combinations(matches, 2)
        if _possible(a, b, places) and _in_order((*lying, (a.order, a.place), (b.order, b.place)))
    ]  # fmt: skip
    behind = [g for i, _ in lying if free(g := _grasp(corners[i]))]
    ranked: list[tuple[Pull, ...]] = [
        *((flap,) for flap in flaps),
        *((a.pull, b.pull) for a, b in sorted(couples, key=lambda c: c[0].away + c[1].away)),
        *((m.pull, *_anchor(m.pull, behind)) for m in sorted(matches, key=lambda m: m.away)),
    ]
    for pull in _tautened(contour, flat, possible):
        if free(pull.grasp) and all(np.linalg.norm(pull.grasp - p[0].grasp) > AWAY for p in ranked):
            ranked.append((pull, *_anchor(pull, behind)))
    if fruitless < len(ranked):
        return Outcome(ranked[fruitless])
    if not missing:
        return Outcome(failure=_impossible("every corner lies in its place, and the cloth between them does not"))
    if loose and not within:
        return Outcome(failure=_impossible("no hand can take all cloth at a corner of its outline"))
    return Outcome(failure=_impossible("no corner of its outline has a place within reach to be pulled to"))


def _flaps(contour: Array, places: Sequence[Corner], missing: Sequence[int], possible: Possible) -> Iterator[Pull]:
    """Yield the pull that unfolds the only missing corner, if it lies on the garment: the boundary follows both
    edges that meet at the corner's place, and cuts the corner off. The corner lies as far behind this crease as
    its place lies before it."""
    garment = shapely.Polygon(contour).buffer(-FOLLOWS)
    for k in missing if len(missing) == 1 else ():
        place = places[k]
        ends = [_followed(contour, place, places[j]) for j in (k - 1, (k + 1) % len(places))]
        a, b = (np.full(2, np.nan) if end is None else end for end in ends)
        length = float(np.linalg.norm(b - a))
        if not length > LEAST_FLAP:
            continue
        crease = (b - a) / length
        tip, grasp = (2.0 * (a + (q - a) @ crease * crease) - q for q in (place.point, _grasp(place)))
        pull = replace(_pull(grasp, _grasp(place), contour, possible), upper=True)
        if np.linalg.norm(tip - place.point) > 2.0 * LEAST_FLAP < 2.0 * pull.length and garment.contains(
            shapely.Point(grasp)
        ):
            yield pull


def _tautened(contour: Array, flat: Array, possible: Possible) -> Iterator[Pull]:
    """Yield the pull of the boundary point that a ruck has drawn in the most, to its place on the flat outline."""
    points, gaps = _inside(contour, flat)
    widest = int(np.argmax(gaps))
    if LEAST_GAP < gaps[widest] <= WIDEST_GAP:
        way = (flat[widest] - points[widest]) / gaps[widest]
        pull = _pull(points[widest] - INSET * way, flat[widest] - INSET * way, contour, possible)
        if pull.length > LEAST_GAP:
            yield pull


def _inside(contour: Array, flat: Array) -> tuple[Array, Array]:
    """Return the nearest points (m, 2) of a silhouette with this contour (n, 2) to points `flat` (m, 2), and their
    distances (m,) [m]. They are 0 for points on the silhouette."""
    garment, outline = shapely.Polygon(contour), shapely.points(flat)
    nearest = shapely.get_coordinates(shapely.shortest_line(garment, outline)).reshape(-1, 2, 2)[:, 0]
    return nearest, shapely.distance(garment, outline)


def _followed(contour: Array, corner: Corner, neighbour: Corner) -> Array | None:
    """Return the last point (2,) of the contour (n, 2) that lies on the edge from `neighbour` to `corner`; None if
    the contour follows less than `LEAST_FOLLOWED` of it."""
    edge = corner.point - neighbour.point
    length = float(np.linalg.norm(edge))
    along = (contour - neighbour.point) @ edge / length
    aside = np.abs((contour - neighbour.point) @ np.array([-edge[1], edge[0]])) / length
    along[(aside > FOLLOWS) | (along > length + FOLLOWS)] = -np.inf
    return contour[along.argmax()] if along.max() > LEAST_FOLLOWED * length else None


def pulls_home(places: Sequence[Corner], home: Sequence[Corner], possible: Possible) -> Outcome[tuple[Pull, ...]]:
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
    if not all(possible(np.array([p.grasp, p.target])) and p.length <= LONGEST for p in pulls):
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
        grasps={
            i: Grasp(frozen(p.grasp), _across(p, way), 1, (1 + p.upper) * thickness) for i, p in by_id.items()
        },
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


def _pull(grasp: Array, target: Array, contour: Array, possible: Possible) -> Pull:
    """Return the pull from `grasp` towards `target` (2,), as long as the contour (n, 2) stays where it may be if
    it is dragged along."""
    way, share, step = target - grasp, 0.0, 1.0
    while step > FINEST:
        if share + step <= 1.0 and possible(contour + (share + step) * way):
            share += step
        step *= 0.5
    return Pull(frozen(grasp), frozen(grasp + share * way))


def _anchor(pull: Pull, grasps: Sequence[Array]) -> tuple[Pull, ...]:
    """Return the pull of no length with which the other hand holds the garment at the grasp that lies farthest
    behind the pull, so that the cloth between both becomes taut; none if all lie beside the pull or ahead."""
    way = pull.target - pull.grasp
    behind = min(grasps, key=lambda g: float(g @ way), default=pull.grasp)
    return (Pull(behind, behind),) if float((pull.grasp - behind) @ way) > APART * pull.length else ()


def _in_order(pairs: Sequence[tuple[int, int]]) -> bool:
    """Whether corners come in the order of their places, both counter-clockwise. pairs: indices of both."""
    around = [place for _, place in sorted(pairs)]
    return sum(a > b for a, b in zip(around, around[1:] + around[:1], strict=True)) <= 1


def _distance(a: Corner, b: Corner) -> float:
    return float(np.linalg.norm(a.point - b.point))


def _nearest(corner: Corner, others: Sequence[Corner]) -> float:
    return min((_distance(corner, other) for other in others), default=np.inf)


def _grasp(corner: Corner) -> Array:
    return frozen(corner.point + INSET * corner.inward)


def lies_on(table: Table, points: Array) -> bool:
    """Whether points (n, 2) keep the margin from the table's edge."""
    least, most = np.array([table.x, table.y]).T
    return bool((least + MARGIN <= points).all() and (points <= most - MARGIN).all())


def _side(pull: Pull) -> GraspId:
    """Return the hand on whose side a single pull lies."""
    return GraspId.LEFT if pull.grasp[1] + pull.target[1] > 0.0 else GraspId.RIGHT


def _across(pull: Pull, otherwise: Array) -> float:
    """Return the heading of the held line, across the pull, within a quarter turn of table x [rad]. otherwise:
    direction (2,) for a hand that only holds the cloth."""
    way = pull.target - pull.grasp if pull.length else otherwise
    heading = float(np.arctan2(way[1], way[0])) + 0.5 * np.pi
    return float((heading + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def _impossible(why: str) -> Failure:
    return Failure(
        FailureKind.HEAPED,
        f"the garment cannot be spread: {why}",
        "lay the garment flat where it lay before this fold (its outline is in the report), then retry",
    )
