"""The one test by which a predicted fold is accepted, whether its arcs were optimised or looked up."""

from __future__ import annotations

from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from skills.vocabulary import Array, Failure, FailureKind

__all__ = ["NEARLY", "acceptance_limit", "gains_as_promised", "judge_prediction"]

POOR_SHARE = 0.05
"""D above this share of the garment's diagonal is a fold that is not worth making."""

PROMISE_SLACK = 0.005
"""How far a fold may fall behind what its arcs came to when they were optimised [m]: over a hundred simulated runs
of the towels the executed path did so by 4 mm at most, where the garment lay as the earlier folds had left it."""


NEARLY = 0.001
"""A promise that is missed by no more than this is kept [m]: less is luck of the mesh."""

GAIN_KEPT, LUCK = 0.8, 0.0005
"""Share of the promised gain on the first guess that looked-up arcs have to bring here; what is luck [m of D]."""

LEAST_GAIN = 0.002
"""Arcs that promised to gain less than this on the first guess [m of D] promised nothing; they must not lose."""


def acceptance_limit(rest: Array, promised: float | None = None) -> float:
    """The largest D [m] that is accepted for a garment with rest coordinates (n, 2).

    promised: the D [m] that looked-up arcs came to where they were optimised; without it only the garment counts.
    However it is turned, its diagonal is the largest distance of two of its points.
    """
    limit = POOR_SHARE * float(pdist(rest[ConvexHull(rest).vertices]).max())
    return limit if promised is None else min(limit, promised + PROMISE_SLACK)


def gains_as_promised(d: float, initial: float, promised: float, promised_initial: float) -> bool:
    """Whether arcs with D `d` gain here on the first guess with `initial` what they gained where they came from.

    All four in metres of D; gains are shares of the first guess's D. Where a garment lies worse than the one that
    they were optimised on, both arcs do worse: that breaks no promise.
    """
    if promised_initial - promised < LEAST_GAIN:
        return d <= initial + NEARLY
    return d <= (1.0 - GAIN_KEPT * (1.0 - promised / promised_initial)) * initial + LUCK


def judge_prediction(step: str, dissimilarity: float, limit: float) -> Failure | None:
    """None when a fold predicted to miss the ideal one by `dissimilarity` [m] on average is accepted."""
    if dissimilarity <= limit:
        return None
    return Failure(
        FailureKind.PREDICTION_POOR,
        f"fold {step} would miss its target by {1e3 * dissimilarity:.0f} mm on average, more than"
        f" {1e3 * limit:.0f} mm",
        "lay the garment flatter or elsewhere, or give the optimiser a larger budget",
        {"dissimilarity_m": dissimilarity, "limit_m": limit},
    )
