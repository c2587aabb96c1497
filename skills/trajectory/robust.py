"""Which of the best few arcs bears what happens when a fold is executed.

The lowest of many simulated costs is partly luck, and an arc may owe it to everything being as believed: a high
one that swings the cloth over comes to 5 mm on paper and to 40 mm when it swings a little further. So the best few
are simulated again as a cell might execute them, on a finer mesh, and judged by their mean and their worst: by D
alone, whatever way the arms have to go.
"""

from __future__ import annotations

import numpy as np

from skills.trajectory.problem import Candidate, Evaluator, Mishap
from skills.trajectory.refine import refined
from skills.vocabulary import Array, Side

__all__ = ["MISHAPS", "most_robust"]

LEAN = float(np.deg2rad(10.0))
"""As far as the arms lean a hand without need [rad]."""


def _leaning(left: float, right: float) -> dict[Side, float]:
    return {Side.LEFT: left, Side.RIGHT: right}


MISHAPS = (
    Mishap(_leaning(LEAN, LEAN), along=0.003, across=0.003, friction=0.75, bending=0.85),
    Mishap(_leaning(-LEAN, LEAN), roll=0.5 * LEAN, along=-0.003, friction=1.25),
)
"""Several things at once: hands that lean, tools 3 mm off, a limper cloth on a more slippery table; and the other
way."""

FINER = 0.85
"""Edges of the mesh on which the best few are judged, to those of the mesh that they were found on."""

APART = 0.05
"""Arcs whose inner control points lie nearer than this everywhere are one candidate [of the fold's distance]."""

MARGIN = 0.0005
"""Arcs that are this near to each other bear as much [m of D]: less is luck of the draw."""


def most_robust(evaluator: Evaluator, plain: Candidate, most: int) -> Candidate:
    """The best of `most` arcs: the best seen, the plain one, and the next best seen.

    They are compared by (mean + worst) / 2 of their D as planned and with each mishap. Of those that bear as much,
    up to luck, the plain one is kept. A mishap seldom mends a fold: an arc that is worse as planned than another
    comes to is not simulated again. Takes (number of arcs) x len(MISHAPS) simulations at most, and none where
    there is only one.
    """
    field = _finalists(evaluator, plain, most)
    if len(field) < 2:
        return field[0]
    finer = refined(evaluator.problem, FINER)
    finer.prepare()
    score: dict[Candidate, float] = {}
    for candidate in sorted(field, key=lambda c: c.dissimilarity):
        allowed = MARGIN if candidate is plain else 0.0
        if candidate.dissimilarity < min(score.values(), default=np.inf) + allowed:
            found = np.append(candidate.dissimilarity, evaluator.confirm(finer, candidate, MISHAPS))
            score[candidate] = float(found.mean() + found.max()) / 2
    best = min(score, key=lambda c: score[c])
    return plain if score.get(plain, np.inf) <= score[best] + MARGIN else best


def _finalists(evaluator: Evaluator, plain: Candidate, most: int) -> list[Candidate]:
    """The best seen, then the plain one, then the next best; none twice."""
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
