"""Selects the arc that is least sensitive to deviations in execution.

The arc with the lowest simulated cost may owe this cost partly to chance, because the result of an arc may depend
on exact conditions. For example, a high arc that swings the cloth over has D = 5 mm as planned, but D = 40 mm if
the cloth swings a little further (D: objective.py). The best few arcs are therefore simulated again, on a finer
mesh and with mishaps (`Mishap`). These arcs are ranked by the mean of all their D values, regardless of their
length. The worst D is not part of the score, because the worst of so few values is mostly noise: for jeans, a
score of the mean and the worst D chose an arc with D = 3.7 mm on unseen meshes instead of an arc with D = 2.4 mm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.crease_mesh import mesh_near_creases
from foldcell.skills.fold_plan.folding import crease_segments
from foldcell.skills.plane import barycentric
from foldcell.skills.trajectory.search.problem import Candidate, Evaluator, FoldProblem, Mishap
from foldcell.skills.vocabulary import Array, GraspId

LEAN = float(np.deg2rad(10.0))
"""Typical lean of a hand in execution [rad]."""


def _leaning(left: float, right: float) -> dict[GraspId, float]:
    return {GraspId.LEFT: left, GraspId.RIGHT: right}


MISHAPS = (
    Mishap(_leaning(LEAN, LEAN), along=0.003, across=0.003, friction=0.75),
    Mishap(_leaning(-LEAN, LEAN), roll=0.5 * LEAN, along=-0.003, friction=1.25),
)
"""Two combinations of deviations. In the first, the hands lean, the tools are 3 mm off, and the limpest cloth of
its class lies on a more slippery table. The deviations of the second are roughly opposite, and its cloth is the
stiffest (`mishaps_of`)."""

FINER = 0.8
"""Arcs are simulated again on a finer mesh; this is its edge length relative to the first mesh. A larger value can
fail to expose an arc that is good on one mesh only: an arc for a vest had D = 2.5 mm on the first mesh, 2.2 mm at
0.85, and 4.5 mm at 0.8 and below."""

APART = 0.05
"""Two arcs count as one candidate if all coordinates of their inner control points differ by less than this, in
units of the fold's distance."""

EDGE_QUANTILES = (0.25, 0.95)
"""Two quantiles of the areas of a mesh's triangles. The first is taken as the area of a triangle near creases, the
second as the area of one away from creases."""

MARGIN = 0.0005
"""Arcs within this margin count as equally good [m of D]: smaller differences are noise."""


def mishaps_of(problem: FoldProblem) -> tuple[Mishap, ...]:
    """Return MISHAPS with the range of bending lengths in which the fabric may lie."""
    return tuple(
        replace(mishap, bending=factor) for mishap, factor in zip(MISHAPS, problem.bending_factors, strict=True)
    )


def simulations(finalists: int) -> int:
    """Return the largest number of simulations that `most_robust` makes for `finalists` arcs."""
    return finalists * (1 + len(MISHAPS)) if finalists > 1 else 0


def most_robust(evaluator: Evaluator, plain: Candidate, most: int) -> Candidate:
    """Choose the most robust of up to `most` arcs: the best arc in `evaluator.seen`, the arc `plain`, and the next
    best arcs in `evaluator.seen`.

    The score of an arc is the mean of its D values: as planned on each of the two meshes, and with each mishap.
    The arc with the lowest score is the best. The plain arc is chosen instead if neither its score nor its planned
    D (the mean over both meshes) exceeds that of the best arc by more than MARGIN. A mishap seldom improves a
    fold. Therefore an arc is not simulated further if its planned D exceeds the score of another arc. If there is
    only one arc, it is returned without a simulation.
    """
    field = _finalists(evaluator, plain, most)
    if len(field) < 2:
        return field[0]
    problem, finer = evaluator.problem, refined(evaluator.problem, FINER)
    finer.prepare()
    field = sorted(field, key=lambda c: c.dissimilarity)
    allowed = {c: MARGIN if c is plain else 0.0 for c in field}
    planned: dict[Candidate, float] = {}
    score: dict[Candidate, float] = {}

    def may_win(candidate: Candidate, d: float) -> bool:
        return d < min(score.values(), default=np.inf) + allowed[candidate]

    for lot in (field[:2], field[2:]):  # two at a time, the usual number of threads
        lot = [c for c in lot if may_win(c, c.dissimilarity)]
        again = evaluator.confirm([(finer, c, None) for c in lot])
        planned |= {c: (c.dissimilarity + d) / 2 for c, d in zip(lot, again, strict=True)}
        for c in sorted(lot, key=lambda c: planned[c] - allowed[c]):
            if may_win(c, planned[c]):
                mishaps = evaluator.confirm([(problem, c, mishap) for mishap in mishaps_of(problem)])
                score[c] = float(np.mean([planned[c], planned[c], *mishaps]))
    best = min(score, key=lambda c: score[c])
    if plain not in score or planned[plain] > planned[best] + MARGIN:
        return best
    return plain if score[plain] <= score[best] + MARGIN else best


def _finalists(evaluator: Evaluator, plain: Candidate, most: int) -> list[Candidate]:
    """Return the best arc seen, then the plain one, then the next best, without duplicates."""
    by_cost = sorted((c for c in evaluator.seen if not c.failed), key=lambda c: c.cost)
    if not by_cost:
        return evaluator.seen[:1]
    field = [by_cost[0]]
    for candidate in (plain, *by_cost):
        if len(field) < most and not candidate.failed and all(_apart(evaluator, candidate, f) for f in field):
            field.append(candidate)
    return field


def _apart(evaluator: Evaluator, a: Candidate, b: Candidate) -> bool:
    def inner(c: Candidate) -> Array:
        return np.concatenate([evaluator.problem.frames[s].normalise(q) for s, q in sorted(c.controls.items())])

    return float(np.abs(inner(a) - inner(b)).max()) >= APART


def refined(problem: FoldProblem, share: float) -> FoldProblem:
    """Return `problem` on a mesh with edges `share` times as long, with the garment in the same shape. The mesh is
    finer near the creases of this fold and of the earlier ones, as the problem's own mesh is."""
    mesh = problem.mesh
    # edges of equilateral triangles of the same areas
    fine, coarse = np.sqrt(4.0 / np.sqrt(3.0) * np.quantile(mesh.area, EDGE_QUANTILES))
    outline = shapely.union_all(shapely.polygons(mesh.rest[mesh.triangles[mesh.triangle_layer == 0]]))
    contour = shapely.get_coordinates(outline.exterior)[:-1]
    if not outline.exterior.is_ccw:
        contour = contour[::-1]
    creases = crease_segments(problem.step.lines, contour)
    layers = int(mesh.layer.max()) + 1
    finer = mesh_near_creases(
        contour, share * coarse, layers, 0.0, creases, problem.material.bending_length, share * fine
    )
    return replace(problem, mesh=finer, positions=carried(mesh, problem.positions, finer.rest, finer.layer))


def carried(mesh: ClothMesh, positions: Array, rest: Array, layer: NDArray) -> Array:
    """Return (m, 3): the positions of material points on a mesh whose vertices are at `positions` (n, 3). The
    points are given by rest (m, 2) and layer (m,).

    A point outside the mesh, as on a resampled border, is extrapolated from the nearest triangle.
    """
    out = np.empty((len(rest), 3))
    for sheet in np.unique(layer):
        own = np.flatnonzero(layer == sheet)
        triangles = mesh.triangles[mesh.triangle_layer == sheet]
        corners = mesh.rest[triangles]
        nearest = shapely.STRtree(shapely.polygons(corners)).nearest(shapely.points(rest[own]))
        weights = barycentric(corners[nearest], rest[own])
        out[own] = np.einsum("ik,ikd->id", weights, positions[triangles[nearest]])
    return out
