"""The one test by which a predicted fold is accepted, whether its arcs were optimised or looked up."""

from __future__ import annotations

import numpy as np

from skills.vocabulary import Array, Failure, FailureKind

__all__ = ["acceptance_limit", "judge_prediction"]

POOR_SHARE = 0.05
"""D above this share of the garment's diagonal is a fold that is not worth making."""

PROMISE_SLACK = 0.005
"""How far a fold may fall behind what its arcs came to when they were optimised [m]: over a hundred simulated runs
of the towels the executed path did so by 4 mm at most, where the garment lay as the earlier folds had left it."""


def acceptance_limit(rest: Array, promised: float | None = None) -> float:
    """The largest D [m] that is accepted for a garment with rest coordinates (n, 2).

    promised: the D [m] that looked-up arcs came to where they were optimised; without it only the garment counts.
    """
    limit = POOR_SHARE * float(np.linalg.norm(np.ptp(rest, axis=0)))
    return limit if promised is None else min(limit, promised + PROMISE_SLACK)


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
