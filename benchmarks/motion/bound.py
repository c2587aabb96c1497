"""Lower bound on the duration of a path: no jerk limit, a dense grid, linear programs.

With b = (ds/dt)^2 at n + 1 grid points and (b[k+1] - b[k]) / (2 ds) for the path's acceleration, the joints'
limits are linear in b, and the time  T(b) = sum 2 ds / (sqrt b[k] + sqrt b[k+1])  is convex (Verscheure et al.,
IEEE TAC 54(10), 2009). The method is Kelley's cutting planes: a tangent plane of T lies below T. The minimum of
the tangent planes over the limits is a linear program, and it is a true lower bound of the discretised problem.
The best b so far gives an upper bound. The code shares nothing with the planner's timing or with TOPP-RA.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array, vstack

from robots.model import JointLimits
from robots.ports import Array

__all__ = ["TimeBound", "time_bound"]

GRID = 200
PLANES = 12
GAP = 0.003
"""Relative distance between upper and lower bound at which the iteration ends."""


@dataclass(frozen=True)
class TimeBound:
    """lower: no motion within the limits is faster [s]. upper: duration of the best motion found on the same grid
    [s]."""

    lower: float
    upper: float

    @property
    def gap(self) -> float:
        return self.upper / self.lower - 1.0


def time_bound(
    path: Array, limits: JointLimits, *, lengths: Array | None = None, speed: float | None = None, grid: int = GRID
) -> TimeBound:
    """Bounds for a motion from rest to rest along the cubic spline through joint samples (m, 14), which are spaced
    by their largest joint step.

    lengths: (m, k) distances that k tools have travelled [m]. speed: maximum speed of each tool [m/s].
    """
    step = np.maximum(np.abs(np.diff(path, axis=0) / limits.velocity).max(axis=1), 1e-9)
    s = np.concatenate([[0.0], np.cumsum(step)])
    curve = CubicSpline(s, path)
    u = np.linspace(0.0, s[-1], grid + 1)
    d = float(u[1] - u[0])
    slope = curve(u, 1)
    most = ((limits.velocity / np.maximum(np.abs(slope), 1e-12)) ** 2).min(axis=1)
    if lengths is not None and speed is not None:
        rate = np.maximum(np.abs(CubicSpline(s, lengths)(u, 1)), 1e-9)
        most = np.minimum(most, ((speed / rate) ** 2).min(axis=1))
    most[0] = most[-1] = 0.0
    return _kelley(_acceleration(curve, u, d, limits), most, d)


def _acceleration(curve: CubicSpline, u: Array, d: float, limits: JointLimits) -> csr_array:
    """Rows with A b <= 1: |q' a + q'' b| <= limit in the middle of each interval, where a is its constant
    acceleration.

    A has one more column than b, which is empty and belongs to the time.
    """
    middle = (u[1:] + u[:-1]) / 2
    slope, bend = curve(middle, 1) / limits.acceleration, curve(middle, 2) / limits.acceleration
    n, dof = slope.shape
    k, row = np.repeat(np.arange(n), dof), np.arange(n * dof)
    values = np.concatenate([(bend / 2 - slope / (2 * d)).ravel(), (bend / 2 + slope / (2 * d)).ravel()])
    places = (np.concatenate([row, row]), np.concatenate([k, k + 1]))
    A = csr_array(coo_array((values, places), shape=(n * dof, n + 2)))
    return csr_array(vstack([A, -A]))


def _kelley(A: csr_array, most: Array, d: float) -> TimeBound:
    """Bounds of the minimum of T over {A b <= 1, 0 <= b <= most}. The last unknown represents T and lies above all
    tangent planes."""
    n = len(most)
    bounds = [*((0.0, float(m)) for m in most), (0.0, None)]
    rows, right = A, np.ones(A.shape[0])
    time_only = np.append(np.zeros(n), 1.0)
    # Start with the largest b. It is the solution if the feasible set is a lattice, and otherwise a good start.
    best = linprog(time_only - 1.0, A_ub=rows, b_ub=right, bounds=bounds, method="highs").x[:n]
    b, lower, upper = best, 0.0, np.inf
    for _ in range(PLANES):
        time, gradient = _time(b, d)
        if time < upper:
            upper, best = time, b
        rows = csr_array(vstack([rows, csr_array(np.append(gradient, -1.0)[None, :])]))
        right = np.append(right, gradient @ b - time)
        solved = linprog(time_only, A_ub=rows, b_ub=right, bounds=bounds, method="highs")
        if solved.status != 0:
            break
        lower = max(lower, float(solved.x[-1]))
        if upper - lower < GAP * upper:
            break
        b = 0.5 * (best + solved.x[:n])  # The midpoint is never zero inside, where the tangent would be vertical.
    return TimeBound(lower, upper)


def _time(b: Array, d: float) -> tuple[float, Array]:
    """T(b) and its gradient, for b that is positive except at its ends."""
    root = np.sqrt(b)
    sums = root[1:] + root[:-1]
    each = -d / sums**2
    gradient = np.zeros_like(b)
    gradient[1:-1] = (each[:-1] + each[1:]) / root[1:-1]
    return float((2.0 * d / sums).sum()), gradient
