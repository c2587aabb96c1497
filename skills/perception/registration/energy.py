"""The contour energy of the registration, and its Jacobian.

E_T(S, S~) = E_fit + kappa E_stretch + beta E_bend of Li et al., "Folding Deformable Objects using Predictive
Simulation and Trajectory Optimization" (2015), section on key point localisation, as a sum of squares:

E_fit     = sum_i dist_T(m_i)^2 l_i                      m_i, l_i: midpoint and length of segment i
E_stretch = 1/2 sum_i (l_i / l~_i - 1)^2 l~_i            l~_i: length in the reference contour
E_bend    = 1/2 sum_j (t_j / t~_j - 1)^2 L~_j            t_j: interior angle at vertex j, in (0, 2 pi)

E_fit does not notice if the contour covers only a part of the garment's boundary. A second data term therefore
penalises boundary samples that are far from the contour:

E_cover   = w sum_k dist_S(q_k)^2 h                      q_k: boundary samples, h [m] apart
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.compiled import cached
from foldcell.skills.perception.outline import (
    counter_clockwise,
    interior_angles,
    outward_normals,
    resample_closed,
    segment_lengths,
)

NORMAL_REACH = 0.05
"""Distance [m] that is added if a contour segment faces the opposite way to the boundary. It prevents the edge of
a sleeve from matching the edge of the body."""


@dataclass(frozen=True)
class EnergyWeights:
    """kappa, beta: the paper's weights [m2]. cover: weight of the second data term; 0 gives the paper's energy."""

    kappa: float = 0.02
    beta: float = 0.01
    cover: float = 1.0


class Boundary:
    """The observed boundary: finely resampled points for distances, and coarse samples for E_cover.

    It is made from a polygon (k, 2) [m], which may run in either direction. points: (n, 2) [m], counter-clockwise.
    Both are closed implicitly. A distance is computed from the nearest point of the fine resampling; there is no
    stored grid of distances.
    """

    def __init__(self, points: Array, step: float = 0.0015, sample_step: float = 0.012) -> None:
        self.points = resample_closed(counter_clockwise(points), step)
        self.normals = outward_normals(self.points)
        gaps = np.linalg.norm(np.roll(self.points, -1, axis=0) - self.points, axis=1)
        self._step = float(gaps.max()) + 1e-12
        keep = np.arange(0, len(self.points), max(round(sample_step / step), 1))
        self.samples = self.points[keep]
        self.sample_normals = self.normals[keep]
        self.length = float(gaps.sum())
        self.sample_spacing = self.length / len(keep)

    def nearest(self, x: Array) -> tuple[Array, NDArray[np.intp]]:
        """Find the nearest of `points` for x (m, 2): its distance (m,) and its index (m,)."""
        return _nearest(self.points, self._step, np.ascontiguousarray(x, dtype=float))

    def distance(self, x: Array) -> tuple[Array, Array]:
        """Compute the signed distance (m,) of x (m, 2), positive outside, and its gradient (m, 2)."""
        far, index = self.nearest(x)
        offset = x - self.points[index]
        normal = self.normals[index]
        along = (offset * normal).sum(axis=1)
        near = far < 0.004
        sign = np.where(along >= 0, 1.0, -1.0)
        distance = np.where(near, along, sign * far)
        radial = offset * (sign / np.maximum(far, 1e-9))[:, None]
        return distance, np.where(near[:, None], normal, radial)


@dataclass(frozen=True, eq=False)
class ContourTerms:
    """Residuals r (m,) of the energy, E = r . r, and their derivatives.

    Residual k depends only on the vertices with the indices vertex[k] (3,), with derivatives gradient[k] (3, 2).
    If it depends on fewer than three vertices, the gradient of the others is 0. count: number of vertices of the
    contour.
    """

    r: Array
    vertex: NDArray[np.int64]
    gradient: Array
    count: int

    @property
    def energy(self) -> float:
        # Not r @ r: BLAS would use threads, whose synchronisation takes milliseconds on a busy machine.
        return float((self.r * self.r).sum())

    def normal_equations(self) -> tuple[Array, Array]:
        """Compute J^T J (2 n, 2 n) and J^T r (2 n,)."""
        return _normal(self.r, self.vertex, self.gradient, self.count)


def contour_terms(X: Array, reference: Array, boundary: Boundary, weights: EnergyWeights) -> ContourTerms:
    """Compute the terms of the energy for the vertices X (n, 2) [m]. reference: (n, 2) vertices that define the
    rest lengths and rest angles."""
    lengths, angles = segment_lengths(reference), interior_angles(reference)
    n, cover = len(X), weights.cover > 0
    q = boundary.samples if cover else boundary.samples[:0]
    rows = 3 * n + len(q)
    r, vertex, gradient = np.zeros(rows), np.zeros((rows, 3), np.int64), np.zeros((rows, 3, 2))
    X = np.ascontiguousarray(X, dtype=float)
    distance, slope = boundary.distance(0.5 * (X + np.concatenate((X[1:], X[:1]))))
    _shape_terms(
        X, lengths, angles, interior_angles(X), distance, slope, weights.kappa, weights.beta, r, vertex, gradient
    )
    if cover:
        segment, t, foot = closest_segments(X, q, boundary.sample_normals)
        scale = float(np.sqrt(weights.cover * boundary.sample_spacing))
        _cover_terms(X, q, segment, t, foot, scale, r[3 * n :], vertex[3 * n :], gradient[3 * n :])
    return ContourTerms(r, vertex, gradient, n)


def solve_damped(A: Array, g: Array, damping: float) -> Array:
    """Solve (A + damping I) x = g for x (n,). A: (n, n) symmetric and positive semidefinite.

    The method is a Cholesky factorisation that skips the leading zeros of each row. It is fast, because a
    contour's vertices couple only to their neighbours, so that all rows except the last ones are short.
    """
    return np.asarray(_solve(A, g, float(damping)))


@cached()
def _shape_terms(  # type: ignore[no-untyped-def]
    X, rest, angle, seen, distance, slope, kappa, beta, r, vertex, gradient
):
    """Fills in the residuals of E_fit, E_stretch and E_bend, n each, and their derivatives."""
    n = len(X)
    for i in range(n):
        j, h = (i + 1) % n, (i - 1) % n
        ex, ey = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1]
        length = max(np.sqrt(ex * ex + ey * ey), 1e-9)
        root = np.sqrt(length)
        r[i] = root * distance[i]
        vertex[i, 0], vertex[i, 1], vertex[i, 2] = i, j, i
        by_length = 0.5 * distance[i] / root / length
        for k, e in ((0, ex), (1, ey)):
            gradient[i, 0, k] = 0.5 * root * slope[i, k] - by_length * e
            gradient[i, 1, k] = 0.5 * root * slope[i, k] + by_length * e
        at_rest = max(rest[i], 1e-6)
        scale = np.sqrt(0.5 * kappa * at_rest)
        s = n + i
        r[s] = scale * (length / at_rest - 1.0)
        vertex[s, 0], vertex[s, 1], vertex[s, 2] = i, j, i
        for k, e in ((0, ex), (1, ey)):
            gradient[s, 0, k] = -scale / at_rest / length * e
            gradient[s, 1, k] = scale / at_rest / length * e
        # An angle grows when its second side v turns left and its first side u turns right.
        vx, vy = X[h, 0] - X[i, 0], X[h, 1] - X[i, 1]
        uu, vv = max(ex * ex + ey * ey, 1e-12), max(vx * vx + vy * vy, 1e-12)
        scale = np.sqrt(0.5 * beta * 0.5 * (rest[i] + rest[h]))
        b = 2 * n + i
        r[b] = scale * (seen[i] / angle[i] - 1.0)
        vertex[b, 0], vertex[b, 1], vertex[b, 2] = h, j, i
        factor = scale / angle[i]
        gradient[b, 0, 0], gradient[b, 0, 1] = -factor * vy / vv, factor * vx / vv
        gradient[b, 1, 0], gradient[b, 1, 1] = factor * ey / uu, -factor * ex / uu
        for k in range(2):
            gradient[b, 2, k] = -gradient[b, 0, k] - gradient[b, 1, k]


@cached()
def _cover_terms(X, q, segment, t, foot, scale, r, vertex, gradient):  # type: ignore[no-untyped-def]
    """Fills in the residuals of E_cover, one per boundary sample, and their derivatives."""
    n = len(X)
    for k in range(len(q)):
        i = segment[k]
        j = (i + 1) % n
        ox, oy = foot[k, 0] - q[k, 0], foot[k, 1] - q[k, 1]
        away = np.sqrt(ox * ox + oy * oy)
        if 0.0 < t[k] < 1.0:
            dx, dy = X[j, 1] - X[i, 1], X[i, 0] - X[j, 0]
            size = max(np.sqrt(dx * dx + dy * dy), 1e-12)
            dx, dy = dx / size, dy / size
            r[k] = scale * (ox * dx + oy * dy)
        else:
            dx, dy = ox / max(away, 1e-9), oy / max(away, 1e-9)
            r[k] = scale * away
        vertex[k, 0], vertex[k, 1], vertex[k, 2] = i, j, i
        gradient[k, 0, 0], gradient[k, 0, 1] = scale * (1.0 - t[k]) * dx, scale * (1.0 - t[k]) * dy
        gradient[k, 1, 0], gradient[k, 1, 1] = scale * t[k] * dx, scale * t[k] * dy


@cached()
def _normal(r, vertex, gradient, n):  # type: ignore[no-untyped-def]
    A, g = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    for row in range(len(r)):
        for a in range(3):
            for i in range(2):
                slope, at = gradient[row, a, i], 2 * vertex[row, a] + i
                if slope == 0.0:
                    continue
                g[at] += slope * r[row]
                for b in range(3):
                    for j in range(2):
                        A[at, 2 * vertex[row, b] + j] += slope * gradient[row, b, j]
    return A, g


@cached()
def _solve(A, g, damping):  # type: ignore[no-untyped-def]
    n = len(g)
    L, x, first = np.zeros((n, n)), np.empty(n), np.zeros(n, np.int64)
    for i in range(n):
        while first[i] < i and A[i, first[i]] == 0.0:
            first[i] += 1
        for j in range(first[i], i + 1):
            total = A[i, j]
            if i == j:
                total += damping
            for k in range(max(first[i], first[j]), j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j] if j < i else np.sqrt(max(total, 1e-300))
        x[i] = g[i]
        for k in range(first[i], i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        x[i] /= L[i, i]
        for k in range(first[i], i):
            x[k] -= L[i, k] * x[i]
    return x


def closest_segments(
    X: Array, q: Array, normals: Array, normal_reach: float = NORMAL_REACH
) -> tuple[NDArray[np.intp], Array, Array]:
    """Find the nearest point of the contour X (n, 2) for each of the points q (m, 2): its segment (m,), its
    parameter on the segment (m,) and the foot point (m, 2).

    If a segment faces another way than normals (m, 2), up to normal_reach^2 [m2] is added to its squared distance.
    """
    return _closest(
        np.ascontiguousarray(X), np.ascontiguousarray(q), np.ascontiguousarray(normals), float(normal_reach)
    )


@cached()
def _nearest(points, step, x):  # type: ignore[no-untyped-def]
    """Finds the distance and the index of the nearest of `points` for each x. Neighbouring points are at most
    `step` apart, so the search skips many points that are far away. The result for one x is the first guess for
    the next."""
    distance, index = np.empty(len(x)), np.empty(len(x), np.int64)
    at = 0
    for k in range(len(x)):
        px, py = x[k, 0], x[k, 1]
        best = np.sqrt((px - points[at, 0]) ** 2 + (py - points[at, 1]) ** 2)
        i = 0
        while i < len(points):
            far = np.sqrt((px - points[i, 0]) ** 2 + (py - points[i, 1]) ** 2)
            if far < best:
                best, at = far, i
            i += max(1, int((far - best) / step))
        distance[k], index[k] = best, at
    return distance, index


@cached()
def _closest(X, q, normals, reach):  # type: ignore[no-untyped-def]
    n, m = len(X), len(q)
    edge, square, facing = np.empty((n, 2)), np.empty(n), np.empty((n, 2))
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        edge[i, 0], edge[i, 1] = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1]
        square[i] = max(edge[i, 0] ** 2 + edge[i, 1] ** 2, 1e-12)
        root = np.sqrt(square[i])
        facing[i, 0], facing[i, 1] = edge[i, 1] / root, -edge[i, 0] / root
    segment, along, foot = np.zeros(m, np.int64), np.zeros(m), np.zeros((m, 2))
    for k in range(m):
        best = np.inf
        for i in range(n):
            dx, dy = q[k, 0] - X[i, 0], q[k, 1] - X[i, 1]
            t = min(max((dx * edge[i, 0] + dy * edge[i, 1]) / square[i], 0.0), 1.0)
            gx, gy = t * edge[i, 0] - dx, t * edge[i, 1] - dy
            against = 0.5 * (1.0 - normals[k, 0] * facing[i, 0] - normals[k, 1] * facing[i, 1])
            cost = gx * gx + gy * gy + (reach * against) ** 2
            if cost < best:
                best, segment[k], along[k] = cost, i, t
        i = segment[k]
        foot[k, 0], foot[k, 1] = X[i, 0] + along[k] * edge[i, 0], X[i, 1] + along[k] * edge[i, 1]
    return segment, along, foot
