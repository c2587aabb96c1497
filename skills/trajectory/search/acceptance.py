"""Acceptance test of a predicted fold, the same for optimised and looked-up arcs.

D is the dissimilarity of a predicted fold from its target (objective.py), and the first guess is the paper's
initial arc (bezier.py).
"""

from __future__ import annotations

from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from foldcell.skills.vocabulary import Array, Failure, FailureKind

POOR_SHARE = 0.05
"""Largest accepted D of a fold, as a share of the garment's diagonal."""

PROMISE_SLACK = 0.005
"""Largest accepted difference between D of looked-up arcs in the present fold and their D in the optimisation [m].
In a hundred simulated runs of the towels, this difference was 4 mm at most for the executed path. It arose because
the garment lay where the earlier folds had left it."""


NEARLY = 0.001
"""Tolerance for a promised D [m]: smaller differences are noise of the mesh."""

GAIN_KEPT, LUCK = 0.8, 0.0005
"""GAIN_KEPT: share of the promised gain over the first guess that looked-up arcs have to reach in the present
fold. LUCK: noise of D [m]."""

LEAST_GAIN = 0.002
"""If the promised gain of arcs over the first guess is smaller than this [m of D], they need not gain anything;
they only must not be worse than the first guess."""


def acceptance_limit(rest: Array, promised: float | None = None) -> float:
    """Return the largest accepted D [m] for a garment with rest coordinates (n, 2).

    promised: the D [m] of looked-up arcs in their optimisation; if it is None, the limit depends on the garment
    alone. The diagonal is the largest distance between two points of the garment, whatever its orientation.
    """
    limit = POOR_SHARE * float(pdist(rest[ConvexHull(rest).vertices]).max())
    return limit if promised is None else min(limit, promised + PROMISE_SLACK)


def gains_as_promised(d: float, initial: float, promised: float, promised_initial: float) -> bool:
    """Return whether arcs with D `d` gain as much over the first guess, which has D `initial`, as they did in
    their optimisation.

    All four arguments are values of D [m]; a gain is a share of the first guess's D. If the garment lies less well
    than in the optimisation, D of the arcs and of the first guess both increase; this does not break the promise.
    """
    if promised_initial - promised < LEAST_GAIN:
        return d <= initial + NEARLY
    return d <= (1.0 - GAIN_KEPT * (1.0 - promised / promised_initial)) * initial + LUCK


def judge_prediction(step: str, dissimilarity: float, limit: float) -> Failure | None:
    """Return None if a fold with a predicted D `dissimilarity` [m] is accepted, else the failure."""
    if dissimilarity <= limit:
        return None
    return Failure(
        FailureKind.PREDICTION_POOR,
        f"fold {step} would miss its target by {1e3 * dissimilarity:.0f} mm on average, more than"
        f" {1e3 * limit:.0f} mm",
        "lay the garment flatter or elsewhere, or give the optimiser a larger budget",
        {"dissimilarity_m": dissimilarity, "limit_m": limit},
    )
