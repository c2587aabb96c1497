"""Compute confidence intervals and tests of proportions, and intervals of paired differences."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, sqrt

Z_95 = 1.959963984540054
"""Quantile of the standard normal distribution that leaves 2.5 % above it."""
RESAMPLES = 9999
BLOCK = 1_000_000
"""Largest number of values that are drawn at a time, which limits the memory."""
SEED = 20_150_928
"""Seed of the bootstrap resampling. It is fixed, so that the same values always give the same interval."""


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a proportion (Wilson 1927). It is also accurate near 0 and 1, and for
    few runs."""
    if runs == 0:
        return 0.0, 1.0
    share, z2 = successes / runs, Z_95**2 / runs
    half = sqrt(z2 * (share * (1.0 - share) + z2 / 4.0))
    low, high = ((share + z2 / 2.0 + sign * half) / (1.0 + z2) for sign in (-1.0, 1.0))
    return max(low, 0.0) if successes else 0.0, min(high, 1.0) if successes < runs else 1.0


def mcnemar_exact(only_first: int, only_second: int) -> float:
    """Return the two-sided p-value of McNemar's exact test. Of the pairs with different results, `only_first`
    succeeded only in the first variant and `only_second` only in the second. Returns 1 if there are no such
    pairs."""
    pairs, fewer = only_first + only_second, min(only_first, only_second)
    return min(1.0, sum(comb(pairs, k) for k in range(fewer + 1)) * 2 / 2**pairs)


def bootstrap_median(values: Sequence[float]) -> tuple[float, float] | None:
    """Return the 95 % percentile bootstrap interval (Efron 1979) of the median; None for fewer than two values."""
    import numpy as np

    if len(values) < 2:
        return None
    generator = np.random.default_rng(SEED)
    known, block = np.asarray(values, dtype=float), max(1, BLOCK // len(values))
    medians = [
        np.median(generator.choice(known, (min(block, RESAMPLES - at), len(known))), axis=1)
        for at in range(0, RESAMPLES, block)
    ]
    low, high = np.quantile(np.concatenate(medians), [0.025, 0.975])
    return float(low), float(high)
