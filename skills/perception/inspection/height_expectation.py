"""Expects the height of a fold whose fabric is known only as a class, and judges an observed height by it. The
camera's bias is estimated before, from the flat garment.

An unpressed crease is as high as its fabric is stiff. The height allowed is therefore that of the ideal fold, made
without grippers and settled, plus a margin. Its bending length is estimated from the first crease of the run. All
errors are taken as normal and independent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.perception.inspection.claim import ClaimSettings
from foldcell.skills.perception.inspection.target_view import StackHeights
from foldcell.skills.vocabulary import Array, frozen

_Z = np.linspace(-6.0, 6.0, 601)
_WEIGHT = np.exp(-0.5 * _Z**2) / np.exp(-0.5 * _Z**2).sum()
_ERF = np.vectorize(math.erf, otypes=[float])
RIM = 11
"""Side of the square by which the silhouette is eroded [px]. At its rim, hems stand high and depths of cloth and
table are mixed."""
FEWEST = 1000
"""Fewest pixels of which the median is taken."""
PLAUSIBLE = 4.0
"""An estimate further than this many standard deviations from the expected bias is not believed."""


@dataclass(frozen=True)
class Normal:
    """A quantity with its standard deviation."""

    mean: float
    sigma: float

    def at_most(self, other: Normal) -> float:
        """Probability that this quantity is at most another, independent one."""
        return float(_normal_cdf((other.mean - self.mean) / max(math.hypot(self.sigma, other.sigma), 1e-9)))


@dataclass(frozen=True, eq=False)
class IdealHeights:
    """Heights of the ideal fold for k bending lengths [m], each (k,). bending_lengths increases, and the heights
    do not decrease with it (see `rising`).

    height_m, crease_height_m: after the last step, away from and near the creases. first_crease_m: near the crease
    after the first step. All are of the middle of the upper layer, as in `StackHeights`.
    """

    bending_lengths: Array
    height_m: Array
    crease_height_m: Array
    first_crease_m: Array


@dataclass(frozen=True)
class CameraBias:
    """Bias of the camera's heights [m], positive if cloth is seen too high, and its standard deviation [m].
    measured: False if the expected value of the settings is used instead of an estimate."""

    value: float
    sigma: float
    measured: bool


@dataclass(frozen=True)
class Flatness:
    """flat: whether both heights are within their limits. probability: that the true heights are within the true
    limits. Limits [m]."""

    flat: bool
    probability: float
    height_limit_m: float
    crease_height_limit_m: float


def estimate_camera_bias(
    height: NDArray[np.float32],
    mask: NDArray[np.bool_],
    layers: int,
    thickness: float,
    thickness_sigma: float = 0.0,
    *,
    settings: ClaimSettings,
) -> CameraBias:
    """Estimate the bias: the median height over the interior of a flat garment minus its true height.

    height: (H, W) above the table [m], NaN where unknown. mask: (H, W) of the garment. layers: number of layers of
    the flat garment, each `thickness` [m] thick, with the standard deviation `thickness_sigma`. The true height is
    that of the middle of the upper layer, as in the simulation and the score.

    If too little is visible, or if the estimate is implausible (for example because the garment is crumpled), the
    result is the expected bias of the settings.
    """
    expected = CameraBias(settings.camera_bias, settings.camera_bias_sigma, measured=False)
    interior = cv2.erode(mask.astype(np.uint8), np.ones((RIM, RIM), np.uint8)) > 0
    samples = height[interior & np.isfinite(height)]
    if len(samples) < FEWEST:
        return expected
    value = float(np.median(samples)) - (layers - 0.5) * thickness
    if abs(value - expected.value) > PLAUSIBLE * expected.sigma:
        return expected
    return CameraBias(value, (layers - 0.5) * thickness_sigma, measured=True)


def rising(table: IdealHeights) -> IdealHeights:
    """Return the table with heights that do not decrease with the bending length: each is raised to the largest
    height of all softer fabrics. In the simulation, a fold can come to rest a little lower than that of a softer
    fabric."""
    running = (np.maximum.accumulate(h) for h in (table.height_m, table.crease_height_m, table.first_crease_m))
    return IdealHeights(table.bending_lengths, *map(frozen, running))


def scaled_ideal_heights(
    flat: StackHeights,
    predicted: StackHeights,
    flat_first: float,
    predicted_first: float,
    bending_length: float,
    factors: tuple[float, float],
    count: int = 9,
) -> IdealHeights:
    """Return the table of ideal heights, scaled from one prediction at the nominal bending length [m].

    The height above the flat stack is taken as proportional to the bending length, as that of a free fold is.
    flat, predicted: heights of the flat target and of the predicted fold after the last step; flat_first,
    predicted_first: near the crease after the first step [m]. factors: smallest and largest bending length,
    relative to the nominal one.
    """
    share = np.linspace(*factors, count)

    def scaled(stack: float, nominal: float) -> Array:
        return frozen(stack + max(nominal - stack, 0.0) * share)

    return IdealHeights(
        frozen(bending_length * share),
        scaled(flat.height_m, predicted.height_m),
        scaled(flat.crease_height_m, predicted.crease_height_m),
        scaled(flat_first, predicted_first),
    )


def estimate_bending(table: IdealHeights, first_crease: Normal | None) -> Normal:
    """Estimate the bending length [m] from the observed height of the first crease [m].

    The prior is uniform over the table's range. The observation is inverted through the table, and the two are
    combined with weights 1 / sigma^2. Without an observation (None or NaN), the result is the prior.
    """
    c = table.bending_lengths
    prior = Normal(0.5 * float(c[0] + c[-1]), float(c[-1] - c[0]) / math.sqrt(12.0))
    rise = float(table.first_crease_m[-1] - table.first_crease_m[0])
    if first_crease is None or not math.isfinite(first_crease.mean) or prior.sigma <= 0.0 or rise <= 0.0:
        return prior
    # a straight extension of the table lets heights beyond its range count
    observed, slope = _line_at(table.first_crease_m, c, first_crease.mean)
    sigma = max(slope * first_crease.sigma, 1e-9)
    weight = prior.sigma**2 / (prior.sigma**2 + sigma**2)
    mean = prior.mean + weight * (observed - prior.mean)
    return Normal(float(np.clip(mean, c[0], c[-1])), math.sqrt(weight) * sigma)


def expected_heights(table: IdealHeights, bending: Normal, ideal_sigma: float = 0.0) -> tuple[Normal, Normal]:
    """Return the heights of the ideal fold for a bending length [m]: away from and near the creases [m].
    ideal_sigma: error of the table [m]."""

    def at(heights: Array) -> Normal:
        mean, slope = _line_at(table.bending_lengths, heights, bending.mean)
        return Normal(mean, math.hypot(slope * bending.sigma, ideal_sigma))

    return at(table.height_m), at(table.crease_height_m)


def judge_flatness(
    height: Normal, crease: Normal | None, expected: tuple[Normal, Normal], stack: Normal, settings: ClaimSettings
) -> Flatness:
    """Judge the observed heights [m]. crease: None if there is nothing near a crease. expected: see
    `expected_heights`. stack: height of the flat stack, layers x thickness.

    Away from creases, the height may reach the larger of the flat stack plus `stack_margin` and the ideal height
    plus `ideal_margin`; near creases, the ideal height plus `crease_margin`.
    """
    bounds = (
        Normal(stack.mean + settings.stack_margin, stack.sigma),
        Normal(expected[0].mean + settings.ideal_margin, expected[0].sigma),
    )
    limit = max(b.mean for b in bounds)
    crease_bound = Normal(expected[1].mean + settings.crease_margin, expected[1].sigma)
    low = height.mean <= limit and (crease is None or crease.mean <= crease_bound.mean)
    probability = _at_most_one(height, bounds) * (1.0 if crease is None else crease.at_most(crease_bound))
    return Flatness(low, probability, limit, crease_bound.mean)


def _at_most_one(value: Normal, bounds: tuple[Normal, Normal]) -> float:
    """Probability that a value is at most the larger of two bounds: 1 - P(it exceeds both), integrated over the
    value."""
    x = value.mean + value.sigma * _Z
    above = [_normal_cdf((x - b.mean) / max(b.sigma, 1e-9)) for b in bounds]
    return float(1.0 - (_WEIGHT * above[0] * above[1]).sum())


def _normal_cdf(z: Array | float) -> Array:
    return 0.5 * (1.0 + _ERF(np.asarray(z, dtype=float) / math.sqrt(2.0)))


def _line_at(x: Array, y: Array, at: float) -> tuple[float, float]:
    """Interpolate y (k,) over increasing x (k,), and beyond its ends along the nearest piece. Returns the value
    and the slope there."""
    i = int(np.clip(np.searchsorted(x, at) - 1, 0, len(x) - 2))
    slope = float((y[i + 1] - y[i]) / max(float(x[i + 1] - x[i]), 1e-12))
    return float(y[i] + slope * (at - x[i])), slope
