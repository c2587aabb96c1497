"""The contour energy of the registration, and its Jacobian.

E_T(S, S~) = E_fit + kappa E_stretch + beta E_bend of Li et al., "Folding Deformable Objects using Predictive
Simulation and Trajectory Optimization" (2015), section on key point localisation, as a sum of squares:

E_fit     = sum_i dist_T(m_i)^2 l_i                      m_i, l_i: midpoint and length of segment i
E_stretch = 1/2 sum_i (l_i / l~_i - 1)^2 l~_i            l~_i: length in the reference contour
E_bend    = 1/2 sum_j (t_j / t~_j - 1)^2 L~_j            t_j: interior angle at vertex j, in (0, 2 pi)

E_fit alone is content when the contour covers a part of the garment's boundary. The second data term asks
the other way round, that every stretch of the boundary has contour near it:

E_cover   = w sum_k dist_S(q_k)^2 h                      q_k: boundary samples, h [m] apart
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robots.ports import Array

__all__ = ["Boundary", "EnergyWeights", "contour_residuals", "interior_angles", "segment_lengths"]


@dataclass(frozen=True)
class EnergyWeights:
    """kappa, beta: the paper's [m2]; cover: weight of the second data term (0 leaves the paper's energy).

    normal_reach: how far [m] the nearest contour point is looked for elsewhere when the boundary there
    faces the opposite way: keeps a sleeve's edge from sticking to the body's.
    """

    kappa: float = 0.02
    beta: float = 0.01
    cover: float = 1.0
    normal_reach: float = 0.05


class Boundary:
    """The observed boundary: its distance field, and samples of it.

    points: (n, 2) [m], counter-clockwise, closed implicitly. The field is evaluated exactly, from the
    nearest point of a fine resampling, instead of being stored on a grid.
    """

    def __init__(self, points: Array, step: float = 0.0015, sample_step: float = 0.012) -> None:
        self.points = resample_closed(points, step)
        self.normals = _normals(self.points)
        self._tree = cKDTree(self.points)
        keep = np.arange(0, len(self.points), max(round(sample_step / step), 1))
        self.samples = self.points[keep]
        self.sample_normals = self.normals[keep]
        self.length = float(np.linalg.norm(np.roll(self.points, -1, axis=0) - self.points, axis=1).sum())
        self.sample_spacing = self.length / len(keep)

    def nearest(self, x: Array) -> tuple[Array, NDArray[np.intp]]:
        """Distance (m,) and index into `points` (m,) for x (m, 2)."""
        distance, index = self._tree.query(x)
        return distance, index

    def distance(self, x: Array) -> tuple[Array, Array]:
        """Signed distance (m,), positive outside, and its gradient (m, 2) at x (m, 2)."""
        far, index = self.nearest(x)
        offset = x - self.points[index]
        normal = self.normals[index]
        along = (offset * normal).sum(axis=1)
        near = far < 0.004
        sign = np.where(along >= 0, 1.0, -1.0)
        distance = np.where(near, along, sign * far)
        radial = offset * (sign / np.maximum(far, 1e-9))[:, None]
        return distance, np.where(near[:, None], normal, radial)


def resample_closed(points: Array, step: float) -> Array:
    """A closed polygon (n, 2) resampled evenly, about `step` apart."""
    closed = np.vstack([points, points[:1]])
    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))]
    s = np.linspace(0.0, arc[-1], max(round(arc[-1] / step), 8), endpoint=False)
    return np.stack([np.interp(s, arc, closed[:, 0]), np.interp(s, arc, closed[:, 1])], axis=1)


def _normals(points: Array) -> Array:
    """Outward unit normals of a counter-clockwise contour, over two neighbours on each side."""
    tangent = np.roll(points, -2, axis=0) - np.roll(points, 2, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)


def segment_lengths(X: Array) -> Array:
    """Lengths (n,) of the closed contour's segments; segment i runs from vertex i to i + 1."""
    edge = np.concatenate((X[1:], X[:1])) - X
    return np.asarray(np.sqrt(edge[:, 0] ** 2 + edge[:, 1] ** 2))


def interior_angles(X: Array) -> Array:
    """Interior angles (n,) in (0, 2 pi) of a counter-clockwise contour (n, 2)."""
    u = np.concatenate((X[1:], X[:1])) - X
    v = np.concatenate((X[-1:], X[:-1])) - X
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.mod(np.arctan2(cross, (u * v).sum(axis=1)), 2 * np.pi)


def contour_residuals(
    X: Array, reference: Array, boundary: Boundary, weights: EnergyWeights
) -> tuple[Array, Array]:
    """Residuals r (m,) with E = r . r, and their Jacobian (m, 2 n) over the vertices X (n, 2) row by row."""
    parts = [
        _fit(X, boundary),
        _stretch(X, reference, weights.kappa),
        _bend(X, reference, weights.beta),
    ]
    if weights.cover > 0:
        parts.append(_cover(X, boundary, weights))
    return np.concatenate([r for r, _ in parts]), np.concatenate([J for _, J in parts])


def _scatter(rows: int, n: int, *blocks: tuple[NDArray[np.intp], Array]) -> Array:
    """A Jacobian (rows, 2 n) from (vertex index per row, gradient (rows, 2)) blocks."""
    J = np.zeros((rows, n, 2))
    row = np.arange(rows)
    for vertex, gradient in blocks:
        J[row, vertex] += gradient
    return J.reshape(rows, 2 * n)


def _fit(X: Array, boundary: Boundary) -> tuple[Array, Array]:
    n = len(X)
    i = np.arange(n)
    j = (i + 1) % n
    edge = X[j] - X[i]
    length = np.maximum(np.linalg.norm(edge, axis=1), 1e-9)
    root = np.sqrt(length)
    distance, gradient = boundary.distance(0.5 * (X[i] + X[j]))
    by_place = 0.5 * root[:, None] * gradient
    by_length = (0.5 * distance / root / length)[:, None] * edge
    return root * distance, _scatter(n, n, (i, by_place - by_length), (j, by_place + by_length))


def _stretch(X: Array, reference: Array, kappa: float) -> tuple[Array, Array]:
    n = len(X)
    i = np.arange(n)
    j = (i + 1) % n
    edge = X[j] - X[i]
    length = np.maximum(np.linalg.norm(edge, axis=1), 1e-9)
    rest = np.maximum(segment_lengths(reference), 1e-6)
    scale = np.sqrt(0.5 * kappa * rest)
    slope = (scale / rest / length)[:, None] * edge
    return scale * (length / rest - 1.0), _scatter(n, n, (i, -slope), (j, slope))


def _bend(X: Array, reference: Array, beta: float) -> tuple[Array, Array]:
    n = len(X)
    j = np.arange(n)
    before, after = (j - 1) % n, (j + 1) % n
    u, v = X[after] - X[j], X[before] - X[j]
    rest = interior_angles(reference)
    lengths = segment_lengths(reference)
    scale = np.sqrt(0.5 * beta * 0.5 * (lengths + np.roll(lengths, 1)))
    # An angle grows when its second leg v turns left and its first leg u turns right.
    turn_v = np.stack([-v[:, 1], v[:, 0]], axis=1) / np.maximum((v * v).sum(axis=1), 1e-12)[:, None]
    turn_u = np.stack([-u[:, 1], u[:, 0]], axis=1) / np.maximum((u * u).sum(axis=1), 1e-12)[:, None]
    k = (scale / rest)[:, None]
    r = scale * (interior_angles(X) / rest - 1.0)
    return r, _scatter(n, n, (before, k * turn_v), (after, -k * turn_u), (j, k * (turn_u - turn_v)))


def _cover(X: Array, boundary: Boundary, weights: EnergyWeights) -> tuple[Array, Array]:
    q = boundary.samples
    segment, t, foot = closest_segments(X, q, boundary.sample_normals, weights.normal_reach)
    following = (segment + 1) % len(X)
    offset = foot - q
    distance = np.linalg.norm(offset, axis=1)
    edge = X[following] - X[segment]
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    inner = (t > 0) & (t < 1)
    along = (offset * normal).sum(axis=1)
    direction = np.where(inner[:, None], normal, offset / np.maximum(distance, 1e-9)[:, None])
    scale = np.sqrt(weights.cover * boundary.sample_spacing)
    r = scale * np.where(inner, along, distance)
    J = _scatter(
        len(q), len(X),
        (segment, scale * (1 - t)[:, None] * direction), (following, scale * t[:, None] * direction),
    )
    return r, J


def closest_segments(
    X: Array, q: Array, normals: Array, normal_reach: float
) -> tuple[NDArray[np.intp], Array, Array]:
    """For points q (m, 2): the nearest segment of the contour (m,), the parameter on it (m,), the foot (m, 2).

    A segment that faces another way than the boundary at q counts as up to `normal_reach` further.
    """
    return _closest(
        np.ascontiguousarray(X), np.ascontiguousarray(q), np.ascontiguousarray(normals), float(normal_reach)
    )


@njit(cache=True, nogil=True)
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
