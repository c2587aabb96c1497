"""Least squares with expensive derivatives: the secant version of Levenberg-Marquardt.

K. Madsen, H. B. Nielsen, O. Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed., IMM, Technical
University of Denmark, 2004, section 3.5 (algorithm 3.34), with the damping of section 3.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.skills.vocabulary import Array

__all__ = ["LeastSquares", "SecantOptions", "secant_levenberg_marquardt"]

Residual = Callable[[Array], Array]
ResidualMany = Callable[[Sequence[Array]], Sequence[Array]]


@dataclass(frozen=True)
class SecantOptions:
    """delta: difference step, in the unit of the variables. tau: initial damping, relative to diag(B'B).

    The search ends when one of these values is below its tolerance: the gradient (max norm), the step (relative to
    |x|), or the improvement of the cost (relative to the cost, in two steps in a row). It also ends after
    max_evaluations evaluations of the residual.
    """

    delta: float = 1e-1
    tau: float = 1e-3
    gradient_tolerance: float = 1e-12
    step_tolerance: float = 1e-8
    improvement_tolerance: float = 1e-4
    max_evaluations: int = 200


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Result of the search. x: (n,) the best point; residual: (m,) at x; cost: |residual|^2 / 2; evaluations:
    number of residual evaluations; reason: the criterion that ended the search."""

    x: Array
    residual: Array
    cost: float
    evaluations: int
    reason: str


def secant_levenberg_marquardt(
    residual: Residual,
    x0: Array,
    options: SecantOptions = SecantOptions(),
    many: ResidualMany | None = None,
    f0: Array | None = None,
) -> LeastSquares:
    """Minimise |residual(x)|^2 / 2 from x0 (n,). residual: a function (n,) -> (m,) or scalar.

    The Jacobian is computed once by forward differences (`many` may evaluate these in parallel) and then updated
    by Broyden's rank-one formula, with an extra difference along a coordinate that the steps neglect. f0: the
    residual at x0 if it is known. Returns the best point seen, even if the step control rejected it.
    """
    run = _Run(residual, many, options)
    x = np.array(x0, dtype=float)
    f = run.at(x) if f0 is None else run.known(x, f0)
    if run.evaluations + len(x) > options.max_evaluations:
        return run.result("evaluations")
    B = run.differences(x, f)
    mu, nu = options.tau * max(float(np.max(np.sum(B * B, axis=0))), 1e-300), 2.0
    turn, stalled = 0, 0
    while True:
        g = B.T @ f
        if np.max(np.abs(g)) <= options.gradient_tolerance:
            return run.result("gradient")
        h = np.asarray(np.linalg.solve(B.T @ B + mu * np.eye(len(x)), -g), dtype=np.float64)
        if np.linalg.norm(h) <= options.step_tolerance * (np.linalg.norm(x) + options.step_tolerance):
            return run.result("step")
        if abs(h[turn]) < 0.8 * np.linalg.norm(h):
            if run.exhausted:
                return run.result("evaluations")
            e = np.zeros(len(x))
            e[turn] = options.delta
            B = _broyden(B, e, run.at(x + e) - f)
        turn = (turn + 1) % len(x)
        if run.exhausted:
            return run.result("evaluations")
        f_new = run.at(x + h)
        B = _broyden(B, h, f_new - f)
        gained = float(f @ f - f_new @ f_new) / 2
        predicted = float(h @ (mu * h - g)) / 2
        if gained > 0:
            stalled = stalled + 1 if gained <= options.improvement_tolerance * (f @ f) / 2 else 0
            x, f = x + h, f_new
            mu, nu = mu * max(1 / 3, 1 - (2 * gained / predicted - 1) ** 3), 2.0
            if stalled >= 2:
                return run.result("improvement")
        else:
            mu, nu = mu * nu, 2 * nu
            if not np.isfinite(mu):
                return run.result("step")


def _broyden(B: Array, h: Array, df: Array) -> Array:
    """Return the matrix nearest to B that maps h to df (equation 3.32)."""
    return B + np.outer(df - B @ h, h) / (h @ h)


class _Run:
    """Counts the evaluations and keeps the best point seen."""

    def __init__(self, residual: Residual, many: ResidualMany | None, options: SecantOptions) -> None:
        self._residual, self._many, self._options = residual, many, options
        self.evaluations = 0
        self._best: tuple[float, Array, Array] | None = None

    @property
    def exhausted(self) -> bool:
        return self.evaluations >= self._options.max_evaluations

    def at(self, x: Array) -> Array:
        self.evaluations += 1
        return self.known(x, self._residual(x))

    def known(self, x: Array, residual: Array) -> Array:
        f = np.atleast_1d(np.asarray(residual, dtype=float))
        cost = float(f @ f) / 2
        if self._best is None or cost < self._best[0]:
            self._best = (cost, x.copy(), f)
        return f

    def differences(self, x: Array, f: Array) -> Array:
        points = [x + e for e in self._options.delta * np.eye(len(x))]
        if self._many is None:
            values = [self.at(p) for p in points]
        else:
            self.evaluations += len(points)
            values = [self.known(p, v) for p, v in zip(points, self._many(points), strict=True)]
        return np.column_stack([(v - f) / self._options.delta for v in values])

    def result(self, reason: str) -> LeastSquares:
        assert self._best is not None
        cost, x, f = self._best
        return LeastSquares(x, f, cost, self.evaluations, reason)
