"""Least squares with expensive derivatives: the secant version of Levenberg-Marquardt.

K. Madsen, H. B. Nielsen, O. Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed., IMM, Technical
University of Denmark, 2004, section 3.5 (algorithm 3.34), with the damping of section 3.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.skills.vocabulary import Array

Residuals = Callable[[Sequence[Array]], Sequence[Array]]
"""Computes the residual (m,) of each of the points (n,)."""


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


def secant_levenberg_marquardt(residuals: Residuals, x0: Array, f0: Array, options: SecantOptions) -> Array:
    """Minimise |residual(x)|^2 / 2 from x0 (n,) with the residual f0 (m,). Returns the best point (n,) to which a
    step led.

    The Jacobian is computed once by forward differences, in one call of `residuals`, and then updated by Broyden's
    rank-one formula, with an extra difference along a coordinate that the steps neglect.
    """
    x, f, left = np.array(x0, dtype=float), f0, options.max_evaluations - len(x0)
    if left < 0:
        return x
    steps = options.delta * np.eye(len(x))
    B = np.column_stack([(value - f) / options.delta for value in residuals(list(x + steps))])
    mu, nu = options.tau * max(float(np.max(np.sum(B * B, axis=0))), 1e-300), 2.0
    turn, stalled = 0, 0
    while stalled < 2 and np.isfinite(mu):
        g = B.T @ f
        if np.max(np.abs(g)) <= options.gradient_tolerance:
            break
        h = np.asarray(np.linalg.solve(B.T @ B + mu * np.eye(len(x)), -g), dtype=np.float64)
        if np.linalg.norm(h) <= options.step_tolerance * (np.linalg.norm(x) + options.step_tolerance):
            break
        if abs(h[turn]) < 0.8 * np.linalg.norm(h) and left > 0:
            B = _broyden(B, steps[turn], residuals([x + steps[turn]])[0] - f)
            left -= 1
        if left <= 0:
            break
        turn = (turn + 1) % len(x)
        f_new = residuals([x + h])[0]
        left -= 1
        B = _broyden(B, h, f_new - f)
        gained = float(f @ f - f_new @ f_new) / 2
        predicted = float(h @ (mu * h - g)) / 2
        if gained > 0:
            stalled = stalled + 1 if gained <= options.improvement_tolerance * (f @ f) / 2 else 0
            x, f = x + h, f_new
            mu, nu = mu * max(1 / 3, 1 - (2 * gained / predicted - 1) ** 3), 2.0
        else:
            mu, nu = mu * nu, 2 * nu
    return x


def _broyden(B: Array, h: Array, df: Array) -> Array:
    """Return the matrix nearest to B that maps h to df (equation 3.32)."""
    return B + np.outer(df - B @ h, h) / (h @ h)
