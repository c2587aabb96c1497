"""Computes a lower bound on the duration of a path, without a jerk limit, by linear programs on a dense grid.

The unknowns are b = (ds/dt)^2 at n + 1 grid points of the path. Acceleration along the path and time are

    a[k] = (b[k+1] - b[k]) / (2 ds)        T(b) = sum 2 ds / (sqrt b[k] + sqrt b[k+1])

The joints' limits are then linear in b, and T is convex (Verscheure et al., IEEE TAC 54(10), 2009). The method is
Kelley's cutting planes. A tangent plane of T lies below T. A linear program minimises the maximum of all tangent
planes within the limits; its result is a true lower bound of the discretised problem. The best b so far gives an
upper bound. Where b is zero inside the path, the tangent plane is vertical. Planes are therefore computed only at
points b that are positive inside. The code shares nothing with the planner's timing or with TOPP-RA.

Repeated samples count as one sample. Where the path turns back on itself, every motion has to stop: the bounds of
the parts before and after are added.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array, vstack

from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Array

__all__ = ["TimeBound", "time_bound"]

GRID = 200
PLANES = 60
"""Maximum number of tangent planes. About ten suffice, unless the first b is almost zero at some point, far below
its value in the solution."""
GAP = 0.003
"""Relative distance between upper and lower bound below which the iteration ends."""
REPEATED = 1e-7
"""Two samples that are nearer to each other than this count as one. The distance is expressed as the time that it
takes at full joint speed [s]."""
TURNED_BACK = 1e-6
"""Tolerance: the path turns back where the cosine of the angle between two successive steps is below -1 plus
this."""


@dataclass(frozen=True)
class TimeBound:
    """Bounds of a duration. lower: no motion within the limits is faster [s]. upper: duration of the best motion
    that was found on the same grid [s]."""

    lower: float
    upper: float

    @property
    def gap(self) -> float:
        return self.upper / self.lower - 1.0 if self.upper > 0.0 else 0.0


def time_bound(
    path: Array, limits: JointLimits, *, lengths: Array | None = None, speed: float | None = None, grid: int = GRID
) -> TimeBound:
    """Compute the bounds for a motion from rest to rest along the cubic spline through joint samples (m, 14). The
    parameter of the spline grows from sample to sample by the largest joint step, in units of the time that it
    takes at full speed.

    lengths: (m, k) distances that k tools have travelled [m]. speed: maximum speed of each tool [m/s]. The bounds
    are zero for a path that does not move. Raises ValueError for a single sample and for values that are not
    finite.
    """
    if len(path) < 2 or not np.all(np.isfinite(path)):
        raise ValueError(f"a path of {len(path)} samples has no time: two or more are needed, all of them finite")
    kept = _without_repeats(path / limits.velocity)
    if len(kept) < 2:
        return TimeBound(0.0, 0.0)
    tools = lengths if lengths is not None and speed is not None else None
    path, tools = path[kept], None if tools is None else tools[kept]
    stops = [0, *_turns_back(path / limits.velocity), len(path) - 1]
    parts = [
        _part_bound(path[a : b + 1], limits, None if tools is None else tools[a : b + 1], speed, grid)
        for a, b in pairwise(stops)
    ]
    return TimeBound(sum(part.lower for part in parts), sum(part.upper for part in parts))


def _without_repeats(path: Array) -> list[int]:
    """Return the indices of the samples of path (m, k) that remain without repeats: each differs from the
    remaining one before it."""
    kept = [0]
    for i in range(1, len(path)):
        if np.abs(path[i] - path[kept[-1]]).max() > REPEATED:
            kept.append(i)
    return kept


def _turns_back(path: Array) -> list[int]:
    """Return the indices of the samples of path (m, k), without repeats, at which the path goes back along the
    line on which it came."""
    step = np.diff(path, axis=0)
    along = step / np.linalg.norm(step, axis=1, keepdims=True)
    cosine = (along[1:] * along[:-1]).sum(axis=1)
    return [int(i) + 1 for i in np.flatnonzero(cosine < TURNED_BACK - 1.0)]


def _part_bound(
    path: Array, limits: JointLimits, lengths: Array | None, speed: float | None, grid: int
) -> TimeBound:
    """Compute the bounds of a path (m, 14) without repeated samples, from rest to rest."""
    step = np.abs(np.diff(path, axis=0) / limits.velocity).max(axis=1)
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
    """Compute the matrix A of the acceleration limits, A b <= 1: |q' a + q'' b| <= limit in the middle of each
    interval, where a is the constant path acceleration in it.

    A has one more column than b has elements. This last column is zero. It belongs to the unknown T of the linear
    programs.
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
    """Compute bounds of the minimum of T over {A b <= 1, 0 <= b <= most}. The last unknown of the linear programs
    represents T and is constrained to lie above all tangent planes."""
    n = len(most)
    bounds = [*((0.0, float(m)) for m in most), (0.0, None)]
    rows, right = A, np.ones(A.shape[0])
    time_only = np.append(np.zeros(n), 1.0)
    # Start with the largest sum of b. It is the solution if the feasible set is a lattice, otherwise a good start.
    fastest = linprog(time_only - 1.0, A_ub=rows, b_ub=right, bounds=bounds, method="highs").x[:n]
    positive = _positive(A, most)
    b = np.clip(fastest, 0.0, most)
    if b[1:-1].min() <= 0.0:
        b = 0.5 * (b + positive)
    best, lower, upper = b, 0.0, np.inf
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
        b = 0.5 * (best + np.clip(solved.x[:n], 0.0, most))  # the midpoint is positive inside, as `best` is
    return TimeBound(lower, upper)


def _positive(A: csr_array, most: Array) -> Array:
    """Return a point of {A b <= 1, 0 <= b <= most} that is positive except at its ends, where `most` is zero."""
    inside = np.where(most > 0.0, 1.0, 0.0)
    share = min(1.0 / float(np.abs(A @ np.append(inside, 0.0)).max()), float(most[1:-1].min()))
    return share * inside


def _time(b: Array, d: float) -> tuple[float, Array]:
    """Compute T(b) and its gradient, for b that is positive except at its ends."""
    root = np.sqrt(b)
    sums = root[1:] + root[:-1]
    each = -d / sums**2
    gradient = np.zeros_like(b)
    gradient[1:-1] = (each[:-1] + each[1:]) / root[1:-1]
    return float((2.0 * d / sums).sum()), gradient
