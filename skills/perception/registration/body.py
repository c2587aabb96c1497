"""The stiff part of a garment: where its body lies, whichever way its sleeves or legs are turned.

A blunt corner, a shoulder or the end of a collar, hardly shows in the outline; how far it is from the body's
edges shows well. The template is laid over the boundary by one motion and a scale along each of its own axes.
Which of its corners are the body's is found by consensus (Fischler and Bolles, Random sample consensus, 1981; as
all pairs of corners are tried, chance has no part in it); then the motion is fitted to the whole boundary, point
to line, with Tukey's weights, which leave the limbs out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.registration.energy import Boundary, closest_segments, segment_lengths

__all__ = ["BodySettings", "lay_body"]


@dataclass(frozen=True)
class BodySettings:
    """Lengths [m]. agree: corners of one body lie within this of where two of them have the others. scale: of
    Tukey's weights at first, shrinking to `last_scale`. stretch: the largest ratio of the two axes' scales."""

    agree: float = 0.02
    scale: float = 0.02
    last_scale: float = 0.008
    normal_reach: float = 0.05
    iterations: int = 15
    stretch: float = 1.25


def lay_body(
    template: Array,
    placed: Array,
    clear: NDArray[np.bool_],
    boundary: Boundary,
    settings: BodySettings | None = None,
) -> Array | None:
    """Where the template's corners (k, 2), counter-clockwise, are if they all belong to the body: (k, 2) [m].

    placed: (k, 2) where they were registered; clear: (k,), which of these the outline shows by itself. None when
    no three of them agree.
    """
    settings = settings or BodySettings()
    ours = _consensus(template, placed, clear, settings.agree)
    if np.count_nonzero(ours) < 3:
        return None
    pose = _similarity(template[ours], placed[ours])
    q, normals = boundary.points[::4], boundary.normals[::4]
    for i in range(settings.iterations):
        tukey = max(settings.scale * 0.8**i, settings.last_scale)
        pose = _closer(pose, template, q, normals, tukey, settings)
    scale = pose.scale
    if scale.max() > settings.stretch * scale.min():
        return None
    return pose.of(template)


@dataclass(frozen=True, eq=False)
class _Pose:
    """p -> R diag(scale) p + t."""

    R: Array
    scale: Array
    t: Array

    def of(self, points: Array) -> Array:
        return np.asarray((points * self.scale) @ self.R.T + self.t)


def _rotation(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _similarity(a: Array, b: Array) -> _Pose:
    """The least squares similarity that lays points a (n, 2) on b (n, 2)."""
    from_, to = a - a.mean(axis=0), b - b.mean(axis=0)
    along = float((from_ * to).sum())
    across = float((from_[:, 0] * to[:, 1] - from_[:, 1] * to[:, 0]).sum())
    R = _rotation(float(np.arctan2(across, along)))
    scale = float(np.hypot(along, across) / (from_**2).sum())
    return _Pose(R, np.full(2, scale), b.mean(axis=0) - scale * R @ a.mean(axis=0))


def _consensus(template: Array, placed: Array, clear: NDArray[np.bool_], agree: float) -> NDArray[np.bool_]:
    """The clear corners that one similarity lays in place: those with the longest edges between them."""
    lengths = segment_lengths(template)
    good = np.flatnonzero(clear)
    best, chosen = 0.0, np.zeros(len(template), bool)
    for n, i in enumerate(good):
        for j in good[n + 1 :]:
            pair = _similarity(template[[i, j]], placed[[i, j]])
            near = clear & (np.linalg.norm(pair.of(template) - placed, axis=1) < agree)
            # A corner counts a little where none of its edges does: a blunt one may lie between two clear ones.
            worth = float(lengths[near & np.roll(near, -1)].sum()) + 0.01 * np.count_nonzero(near)
            if worth > best:
                best, chosen = worth, near
    return chosen


def _closer(pose: _Pose, template: Array, q: Array, normals: Array, tukey: float, settings: BodySettings) -> _Pose:
    """One Gauss-Newton step of point to line: boundary points q (m, 2) against the template's edges."""
    X = pose.of(template)
    segment, t, foot = closest_segments(X, q, normals, settings.normal_reach)
    following = (segment + 1) % len(X)
    edge = X[following] - X[segment]
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
    beyond_ends = (t <= 0.0) | (t >= 1.0)
    r = ((foot - q) * normal).sum(axis=1)
    far = np.where(beyond_ends, np.linalg.norm(foot - q, axis=1), np.abs(r))
    weight = np.clip(1.0 - (far / tukey) ** 2, 0.0, None) ** 2
    source = (1.0 - t)[:, None] * template[segment] + t[:, None] * template[following]
    arm = foot - pose.t
    J = np.column_stack([
        normal, arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0],
        source[:, 0] * (normal @ pose.R[:, 0]), source[:, 1] * (normal @ pose.R[:, 1]),
    ])  # fmt: skip
    W = J * weight[:, None]
    dx, dy, turn, across, along = -np.linalg.solve(W.T @ J + 1e-9 * np.eye(5), W.T @ r)
    scale, place = pose.scale + np.array([across, along]), pose.t + np.array([dx, dy])
    return _Pose(_rotation(float(turn)) @ pose.R, scale, place)
