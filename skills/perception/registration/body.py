"""Fits the pose of a garment's body, its stiff part, for any pose of the sleeves or legs.

A blunt corner, such as a shoulder or the end of a collar, is hardly visible in the outline. Its place follows from
the place of the body, whose edges are visible. The template is placed on the boundary by a rotation, a translation
and a scale along each of its axes. The corners that belong to the body are found by consensus (Fischler and
Bolles, Random sample consensus, 1981), here not with random samples, but with all pairs of corners. The pose is
then fitted to the whole boundary by point-to-line distances with Tukey's weights, which exclude the limbs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import segment_lengths
from foldcell.skills.perception.registration.energy import Boundary, closest_segments
from foldcell.skills.plane import rotation

_AGREE = 0.02
"""If a corner is nearer than this to the place that two other corners predict for it, it agrees with these two
[m]."""
_SCALE, _LAST_SCALE = 0.02, 0.008
"""Initial and last scale of Tukey's weights [m]."""
_ITERATIONS = 15
_STRETCH = 1.25
"""Maximum ratio of the scales along the two axes."""


def lay_body(template: Array, placed: Array, clear: NDArray[np.bool_], boundary: Boundary) -> Array | None:
    """Compute the places (k, 2) [m] of the template's corners (k, 2), counter-clockwise, as if all of them
    belonged to the body. None when fewer than three corners agree, or when the scales along the two axes differ
    too much.

    placed: (k, 2) registered corners [m]. clear: (k,), whether a corner is distinct in the outline.
    """
    body_corners = _consensus(template, placed, clear)
    if np.count_nonzero(body_corners) < 3:
        return None
    pose = _similarity(template[body_corners], placed[body_corners])
    q, normals = boundary.points[::4], boundary.normals[::4]
    for i in range(_ITERATIONS):
        pose = _refined(pose, template, q, normals, max(_SCALE * 0.8**i, _LAST_SCALE))
    return None if pose.scale.max() > _STRETCH * pose.scale.min() else pose.of(template)


@dataclass(frozen=True, eq=False)
class _Pose:
    """Pose of the template: the map p -> R diag(scale) p + t."""

    R: Array
    scale: Array
    t: Array

    def of(self, points: Array) -> Array:
        return np.asarray((points * self.scale) @ self.R.T + self.t)


def _similarity(a: Array, b: Array) -> _Pose:
    """Compute the least-squares similarity (rotation, translation, one scale) that maps points a (n, 2) to b
    (n, 2)."""
    from_, to = a - a.mean(axis=0), b - b.mean(axis=0)
    along = float((from_ * to).sum())
    across = float((from_[:, 0] * to[:, 1] - from_[:, 1] * to[:, 0]).sum())
    R = rotation(float(np.arctan2(across, along)))
    scale = float(np.hypot(along, across) / (from_**2).sum())
    return _Pose(R, np.full(2, scale), b.mean(axis=0) - scale * R @ a.mean(axis=0))


def _consensus(template: Array, placed: Array, clear: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (k,) of clear corners that agree on one similarity from template to outline. Of all sets of
    such corners, the one whose edges are longest in total is taken."""
    lengths = segment_lengths(template)
    clear_indices = np.flatnonzero(clear)
    best, best_set = 0.0, np.zeros(len(template), bool)
    for n, i in enumerate(clear_indices):
        for j in clear_indices[n + 1 :]:
            pair = _similarity(template[[i, j]], placed[[i, j]])
            agreeing = clear & (np.linalg.norm(pair.of(template) - placed, axis=1) < _AGREE)
            # An edge counts only if both its corners agree. A corner between two blunt corners has no such edge,
            # so each agreeing corner also adds a little to the score.
            score = float(lengths[agreeing & np.roll(agreeing, -1)].sum()) + 0.01 * np.count_nonzero(agreeing)
            if score > best:
                best, best_set = score, agreeing
    return best_set


def _refined(pose: _Pose, template: Array, q: Array, normals: Array, tukey_scale: float) -> _Pose:
    """Improve the pose by one Gauss-Newton step on the distances of points q (m, 2) to the template's edges."""
    X = pose.of(template)
    segment, t, foot = closest_segments(X, q, normals)
    next_vertex = (segment + 1) % len(X)
    edge = X[next_vertex] - X[segment]
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
    beyond_ends = (t <= 0.0) | (t >= 1.0)
    r = ((foot - q) * normal).sum(axis=1)
    distance = np.where(beyond_ends, np.linalg.norm(foot - q, axis=1), np.abs(r))
    weight = np.clip(1.0 - (distance / tukey_scale) ** 2, 0.0, None) ** 2
    source = (1.0 - t)[:, None] * template[segment] + t[:, None] * template[next_vertex]
    lever = foot - pose.t
    J = np.column_stack([
        normal, lever[:, 0] * normal[:, 1] - lever[:, 1] * normal[:, 0],
        source[:, 0] * (normal @ pose.R[:, 0]), source[:, 1] * (normal @ pose.R[:, 1]),
    ])  # fmt: skip
    W = J * weight[:, None]
    dx, dy, turn, across, along = -np.linalg.solve(W.T @ J + 1e-9 * np.eye(5), W.T @ r)
    scale, translation = pose.scale + np.array([across, along]), pose.t + np.array([dx, dy])
    return _Pose(rotation(float(turn)) @ pose.R, scale, translation)
