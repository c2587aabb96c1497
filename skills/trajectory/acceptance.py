"""Acceptance test of a predicted fold, the same for optimised and looked-up arcs."""

from __future__ import annotations

from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from skills.vocabulary import Array, Failure, FailureKind

__all__ = ["NEARLY", "acceptance_limit", "gains_as_promised", "judge_prediction"]

POOR_SHARE = 0.05
"""Largest accepted D, as a share of the garment's diagonal."""

PROMISE_SLACK = 0.005
"""How far D of looked-up arcs may exceed the D of their optimisation [m]. Over a hundred simulated runs of the
towels the executed path did so by 4 mm at most, as the garment lay where the earlier folds had left it."""


NEARLY = 0.001
"""Tolerance of a promised D [m]: smaller differences are noise of the mesh."""

GAIN_KEPT, LUCK = 0.8, 0.0005
"""Share of the promised gain on the first guess that looked-up arcs have to keep here; noise of D [m]."""

LEAST_GAIN = 0.002
"""Arcs with a smaller promised gain on the first guess [m of D] promise nothing; they must not lose either."""


def acceptance_limit(rest: Array, promised: float | None = None) -> float:
    """The largest accepted D [m] for a garment with rest coordinates (n, 2).

    promised: the D [m] of looked-up arcs where they were optimised; without it the limit depends on the garment
    alone. The diagonal is the largest distance of two of its points, whatever its orientation.
    """
    limit = POOR_SHARE * float(pdist(rest[ConvexHull(rest).vertices]).max())
    return limit if promised is None else min(limit, promised + PROMISE_SLACK)


def gains_as_promised(d: float, initial: float, promised: float, promised_initial: float) -> bool:
    """Whether arcs with D `d` gain as much on the first guess with `initial` as they gained where they were
    optimised.

    All four in metres of D; gains are shares of the first guess's D. Where the garment lies worse than in the
    optimisation, both arcs do worse, which breaks no promise.
    """
    if promised_initial - promised < LEAST_GAIN:
        return d <= initial + NEARLY
    return d <= (1.0 - GAIN_KEPT * (1.0 - promised / promised_initial)) * initial + LUCK


def judge_prediction(step: str, dissimilarity: float, limit: float) -> Failure | None:
    """None if a fold with a predicted mean deviation `dissimilarity` [m] from the ideal one is accepted."""
    if dissimilarity <= limit:
        return None
    return Failure(
        FailureKind.PREDICTION_POOR,
        f"fold {step} would miss its target by {1e3 * dissimilarity:.0f} mm on average, more than"
        f" {1e3 * limit:.0f} mm",
        "lay the garment flatter or elsewhere, or give the optimiser a larger budget",
        {"dissimilarity_m": dissimilarity, "limit_m": limit},
    )
