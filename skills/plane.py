"""Geometry of the plane: rotations, cross products, positions in triangles; and lengths along polylines."""

from __future__ import annotations

import math

import numpy as np

from foldcell.robots.ports import Array

NO_AREA = 1e-12
"""A triangle with less than half this area has no barycentric coordinates [m2]."""


def rotation(angle: float) -> Array:
    """Return the matrix (2, 2) that turns by `angle` [rad]. Points in rows, (n, 2), are turned by
    `points @ rotation(-angle)`."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def cross(u: Array, v: Array) -> Array:
    """Return the cross products (...,) of vectors (..., 2): twice the signed area that they span."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def barycentric(corners: Array, points: Array) -> Array:
    """Return the barycentric coordinates (m, 3) of points (m, 2), or of one point (2,), in triangles with corners
    (m, 3, 2). They are NaN for triangles without area."""
    a, b, c = np.moveaxis(corners, 1, 0)
    u, v, w = b - a, c - a, points - a
    area = cross(u, v)
    area = np.where(np.abs(area) > NO_AREA, area, np.nan)
    s, t = cross(w, v) / area, cross(u, w) / area
    return np.column_stack([1.0 - s - t, s, t])


def lengths_along(points: Array) -> Array:
    """Return the length (n,) of a polyline (n, d) from its start to each point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def resampled(points: Array, n: int) -> Array:
    """Return n evenly spaced points (n, d) on a polyline (k, d), its ends included."""
    s = lengths_along(points)
    return np.column_stack([np.interp(np.linspace(0.0, s[-1], n), s, column) for column in points.T])
