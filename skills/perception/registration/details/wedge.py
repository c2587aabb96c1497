"""Fits a wedge of table between two pieces of cloth to the colours of a strip of the picture.

In cross-section, a pixel shows a mixture of table and cloth: the share of the table is that of a strip of width w,
blurred by the camera. The width grows with the distance u from the tip, w = k sqrt(u^2 + 2 r u) + c u^2, because a
sewn corner is round and edges are curved. Near the tip, the pieces of cloth shade the table, whose colour is
multiplied by 1 - d exp(-w / h). The parameters are fitted to all channels by robust nonlinear least squares with a
Gaussian prior (Levenberg-Marquardt), and their covariance follows from the curvature of the cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from foldcell.robots.ports import Array

_SHADE = 0.008
"""Width h of a gap in which the shade of the cloth fades [m]."""
_UNIT = 0.1
"""Residual, relative to the contrast of table and cloth, beyond which the loss grows only linearly."""
_CORRELATED = 12.0
"""Number of neighbouring residuals that share an error."""
_UNSEEN = 1e-9
"""Weight that leaves a parameter unknown if no pixel shows it, as the blur of a gap that lies beside the strip."""
_STEPS = 25
_LOW = np.array([-0.08, -0.05, -1.0, 0.02, -0.5, 0.0008, -6.0])
_HIGH = np.array([0.2, 0.05, 1.0, 2.5, 0.9, 0.0035, 6.0])
"""Bounds of the parameters: place (s0, v0) of the tip [m], slope of the middle line, k, d, blur [m], c [1/m]."""


@dataclass(frozen=True, eq=False)
class Strip:
    """Colours along a gap. s: (n,) places along the gap, v: (m,) places across the gap [m]. colours: (n, m, 3),
    minus the cloth's colour. table: (3,) colour of the table. cloth: (n, 3) colour of the cloth beside each row.
    All colours are whitened by the pattern of the cloth; the unit is the contrast of table and cloth. round:
    radius r of the rounding of the sewn tip [m]."""

    s: Array
    v: Array
    colours: Array
    table: Array
    cloth: Array
    round: float

    def rows(self, used: NDArray[np.bool_]) -> Strip:
        return Strip(self.s[used], self.v, self.colours[used], self.table, self.cloth[used], self.round)


@dataclass(frozen=True)
class WedgePrior:
    """place: standard deviation of the tip's place along the gap [m]. growth: expected growth k. growth_log:
    standard deviation of the logarithm of k. curvature: standard deviation of the curvature c [1/m]."""

    place: float
    growth: float
    growth_log: float
    curvature: float

    def residuals(self, p: Array) -> tuple[Array, Array]:
        """Deviations (4,) from the prior [standard deviations], and their Jacobian (4, 7). The prior of the shade
        parameter d is fixed: mean 0.2, standard deviation 0.4."""
        r = np.array([
            p[0] / self.place, np.log(p[3] / self.growth) / self.growth_log,
            (p[4] - 0.2) / 0.4, p[6] / self.curvature,
        ])  # fmt: skip
        J = np.zeros((4, 7))
        J[0, 0], J[1, 3], J[2, 4], J[3, 6] = 1 / self.place, 1 / self.growth_log / p[3], 2.5, 1 / self.curvature
        return r, J


@dataclass(frozen=True, eq=False)
class Wedge:
    """parameters: (7,), see `_LOW`. covariance: (7, 7) of the parameters. misfit: root mean square difference of
    model and picture near the gap, relative to the contrast. cost: of the fit."""

    parameters: Array
    covariance: Array
    misfit: float
    cost: float


def fit_wedge(strip: Strip, starts: list[Array], prior: WedgePrior, count: int) -> Wedge:
    """Fit the wedge to the strip, from each of the `count` best start values (7,) whose tips are apart. Return the
    fit of lowest cost."""
    ranked = sorted(starts, key=lambda p: _first_cost(p, strip))
    chosen: list[Array] = []
    for p in ranked:
        if len(chosen) < count and all(abs(p[0] - q[0]) > 0.015 for q in chosen):
            chosen.append(p)
    return min((_descend(p, strip, prior) for p in chosen), key=lambda wedge: wedge.cost)


def _first_cost(p: Array, strip: Strip) -> float:
    difference = _model(p, strip)[0] - strip.colours
    return float(np.minimum((difference**2).sum(axis=-1), 0.1).sum())


def _descend(start: Array, strip: Strip, prior: WedgePrior) -> Wedge:
    p, damping = np.clip(start, _LOW, _HIGH), 1e-2
    r, J, cost = _residuals(p, strip, prior)
    A = np.einsum("ki,kj->ij", J, J)  # not @: BLAS would use threads
    for _ in range(_STEPS):
        g = np.einsum("ki,k->i", J, r)
        candidate = np.clip(p - np.linalg.solve(A + damping * np.diag(A.diagonal() + 1e-9), g), _LOW, _HIGH)
        next_r, next_J, next_cost = _residuals(candidate, strip, prior)
        if next_cost >= cost:
            damping *= 5.0
            continue
        settled = cost - next_cost < 1e-4 * cost
        p, r, J, cost, damping = candidate, next_r, next_J, next_cost, 0.3 * damping
        A = np.einsum("ki,kj->ij", J, J)
        if settled:
            break
    u = np.maximum(strip.s - p[0], 0.0)
    away = np.abs(strip.v - (p[1] + p[2] * (strip.s - p[0]))[:, None])
    near = away < 0.008 + 0.5 * p[3] * u[:, None]
    difference = ((_model(p, strip)[0] - strip.colours) ** 2).sum(axis=-1)[near]
    A[np.diag_indices_from(A)] += _UNSEEN
    return Wedge(p, _CORRELATED * np.linalg.inv(A), float(np.sqrt(difference.mean())) if near.any() else 1.0, cost)


def _residuals(p: Array, strip: Strip, prior: WedgePrior) -> tuple[Array, Array, float]:
    """Weighted residuals (k,), their Jacobian (k, 7), the cost. The loss of a pixel is 2 (sqrt(1 + r^2) - 1)."""
    model, jacobian = _model(p, strip)
    r = (model - strip.colours) / _UNIT
    root = np.sqrt(1.0 + (r**2).sum(axis=-1, keepdims=True))
    weight = 1.0 / np.sqrt(root)
    prior_r, prior_J = (np.sqrt(_CORRELATED) * term for term in prior.residuals(p))
    return (
        np.concatenate([(r * weight).ravel(), prior_r]),
        np.concatenate([(jacobian * (weight / _UNIT)[..., None]).reshape(-1, 7), prior_J]),
        float((2.0 * (root - 1.0)).sum() + (prior_r**2).sum()),
    )


def _model(p: Array, strip: Strip) -> tuple[Array, Array]:
    """Colours (n, m, 3) according to the parameters `p`, minus the cloth's, and derivatives (n, m, 3, 7)."""
    along = (strip.s - p[0])[:, None]
    u = np.maximum(along, 0.0)
    root = np.sqrt(u * u + 2.0 * strip.round * u + 1e-12)
    width = p[3] * root + p[6] * u * u
    is_open = (along > 0) & (width > 0)
    width = np.maximum(width, 0.0)
    growth = np.where(is_open, p[3] * (u + strip.round) / np.maximum(root, 1e-4) + 2.0 * p[6] * u, 0.0)
    away = strip.v - (p[1] + p[2] * along)
    upper, lower = (away + 0.5 * width) / p[5], (away - 0.5 * width) / p[5]
    covered, fading = ndtr(upper) - ndtr(lower), np.exp(-width / _SHADE)
    on_upper, on_lower = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) / p[5] for z in (upper, lower))
    step = (1.0 - p[4] * fading)[..., None] * strip.table - strip.cloth[:, None]
    by_place = (on_upper - on_lower)[..., None] * step
    by_width = (0.5 * (on_upper + on_lower))[..., None] * step
    by_width = by_width + (covered * (p[4] * fading / _SHADE))[..., None] * strip.table
    jacobian = np.stack([
        by_place * p[2] - by_width * growth[..., None], -by_place, -by_place * along[..., None],
        by_width * (root * is_open)[..., None], -(covered * fading)[..., None] * strip.table,
        -(on_upper * upper - on_lower * lower)[..., None] * step, by_width * (u * u * is_open)[..., None],
    ], axis=-1)  # fmt: skip
    return covered[..., None] * step, jacobian
