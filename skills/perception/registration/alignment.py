"""Aligns two outlines of one shape rigidly, and measures their largest remaining deviation."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.energy import Boundary, closest_segments
from foldcell.skills.plane import rotation

NEAR = 0.030
"""`edge_deviation` [m]: twice the distance between the vertices of a predicted mesh."""


def align(outline: Array, observed: Array, iterations: int = 20) -> tuple[Array, Array]:
    """Compute the rigid motion p -> R p + t, R (2, 2), t (2,) [m], that aligns a boundary (n, 2) with another one
    (m, 2).

    It minimises point-to-line distances in both directions. Tukey's weights prevent a protruding corner from
    rotating the whole outline. The scale of the weights decreases from 60 mm to 10 mm; it stays larger if the
    misfit is large.
    """
    target, source = Boundary(observed, 0.003, 0.010), Boundary(outline, 0.003, 0.010)
    q = source.samples
    R, t = np.eye(2), _robust_centre(target.points) - _robust_centre(source.points)
    for i in range(iterations):
        p = q @ R.T + t
        distance, normal = target.distance(p)
        X = source.points[::4] @ R.T + t
        _, _, foot = closest_segments(X, target.samples, target.sample_normals, 0.03)
        reverse_distance = ((foot - target.samples) * target.sample_normals).sum(axis=1)
        points, normals = np.concatenate([p, foot]), np.concatenate([normal, target.sample_normals])
        r = np.concatenate([distance, reverse_distance])
        scale = max(0.06 * 0.7**i, 3.0 * 1.4826 * float(np.median(np.abs(r))), 0.010)
        weight = np.clip(1.0 - (r / scale) ** 2, 0.0, None) ** 2
        centre = points.mean(axis=0)
        lever = points - centre
        J = np.column_stack([normals, lever[:, 0] * normals[:, 1] - lever[:, 1] * normals[:, 0]])
        A = (J * weight[:, None]).T @ J + np.diag([1e-6, 1e-6, 1e-6])
        dx, dy, turn = -np.linalg.solve(A, (J * weight[:, None]).T @ r)
        dR = rotation(turn)
        R, t = dR @ R, dR @ (t - centre) + centre + (dx, dy)
        if max(abs(dx), abs(dy), 0.3 * abs(turn)) < 1e-5 and i > 8:
            break
    return R, t


def edge_deviation(outline: Array, observed: Array, near: Array | None = None) -> tuple[float, Array]:
    """Return the largest deviation between the two boundaries [m] and its place (2,) [m].

    It is positive if the observed boundary lies outside the outline. A deviation counts only as far as 3 cm of
    boundary deviate by at least that much, to the same side, and only within `NEAR` of the places `near` (k, 2)
    [m], if they are given.
    """
    observed_boundary, outline_boundary = Boundary(observed, 0.003, 0.005), Boundary(outline, 0.003, 0.005)
    candidates = []
    for samples, other, sign in (
        (observed_boundary.samples, outline_boundary, 1.0),
        (outline_boundary.samples, observed_boundary, -1.0),
    ):
        distance, _ = other.distance(samples)
        if near is not None:
            distance[cKDTree(near).query(samples)[0] > NEAR] = 0.0
        window = np.lib.stride_tricks.sliding_window_view(np.r_[distance, distance[:5]], 6)
        persistent = np.where((window > 0).all(axis=1), window.min(axis=1), 0.0)
        persistent = np.where((window < 0).all(axis=1), window.max(axis=1), persistent)
        worst = int(np.argmax(np.abs(persistent)))
        candidates.append((sign * float(persistent[worst]), samples[(worst + 3) % len(samples)]))
    return max(candidates, key=lambda c: abs(c[0]))


def _robust_centre(points: Array) -> Array:
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.25 * (low + high) + 0.5 * points.mean(axis=0)
