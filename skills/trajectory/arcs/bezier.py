"""Bezier curves, the paths of the held points (Farin 1988; section IV-A of the paper that README.md names)."""

from __future__ import annotations

from math import comb

import numpy as np

from skills.vocabulary import Array

__all__ = ["arc_lengths", "bernstein", "evaluate", "initial_controls", "length", "split", "two_parameter_controls"]

UP = np.array([0.0, 0.0, 1.0])


def bernstein(order: int, u: Array) -> Array:
    """Return the Bernstein polynomials B_k^n(u), (m, n + 1), of order n at parameters u (m,) from 0 to 1."""
    u = np.atleast_1d(np.asarray(u, dtype=float))[:, None]
    k = np.arange(order + 1)
    return np.array([comb(order, i) for i in k]) * u**k * (1.0 - u) ** (order - k)


def evaluate(control: Array, u: Array) -> Array:
    """Return the points (m, d) of the curve with control points (n + 1, d) at parameters u (m,)."""
    return bernstein(len(control) - 1, u) @ control


def split(control: Array, u: float = 0.5) -> tuple[Array, Array]:
    """Split a curve at u by de Casteljau subdivision. Returns the control points (n + 1, d) of both pieces."""
    first, last, points = [control[0]], [control[-1]], np.asarray(control, dtype=float)
    while len(points) > 1:
        points = (1.0 - u) * points[:-1] + u * points[1:]
        first.append(points[0])
        last.append(points[-1])
    return np.array(first), np.array(last[::-1])


def length(control: Array, tolerance: float = 1e-6) -> float:
    """Compute the arc length [m] by recursive subdivision, until chord and control polygon of every piece agree.

    tolerance: error of the whole length, relative to the length of the control polygon. Each subdivision halves
    the tolerance of a piece.
    """
    total = float(np.linalg.norm(np.diff(control, axis=0), axis=1).sum())
    if total == 0.0:
        return 0.0
    return _length(np.asarray(control, dtype=float), tolerance * total)


def _length(control: Array, allowed: float) -> float:
    chord = float(np.linalg.norm(control[-1] - control[0]))
    polygon = float(np.linalg.norm(np.diff(control, axis=0), axis=1).sum())
    if polygon - chord <= allowed:
        return chord
    left, right = split(control)
    return _length(left, allowed / 2) + _length(right, allowed / 2)


def arc_lengths(control: Array, samples: int = 400) -> tuple[Array, Array]:
    """Return parameters u (m,) and the length of the curve up to each (m,); interpolation then gives u for a
    length."""
    u = np.linspace(0.0, 1.0, samples + 1)
    # Two-point Gauss on each interval: exact for the speed of a straight cubic, error of 1e-9 for other curves.
    step, centre = 1.0 / samples, (u[1:] + u[:-1]) / 2
    derivative = (len(control) - 1) * np.diff(control, axis=0)
    speed = sum(
        np.linalg.norm(evaluate(derivative, centre + g * step / 2), axis=1) / 2 for g in (-(3**-0.5), 3**-0.5)
    )
    return u, np.concatenate([[0.0], np.cumsum(speed * step)])


def initial_controls(start: Array, end: Array, h: float = 1.0 / 3.0, order: int = 3) -> Array:
    """Return the control points of the paper's first guess: evenly spaced, the inner ones raised by h |P0 -
    Pn|."""
    return two_parameter_controls(start, end, h, 0.0, order)


def two_parameter_controls(start: Array, end: Array, height: float, skew: float, order: int = 3) -> Array:
    """Return the control points of an arc with `height` and `skew`, both in units of |P0 - Pn|: the inner points
    are raised by `height` and shifted towards the end by `skew`."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    chord = end - start
    distance = float(np.linalg.norm(chord))
    controls = start + np.linspace(0.0, 1.0, order + 1)[:, None] * chord
    controls[1:-1] += skew * chord * (1.0, 1.0, 0.0) + height * distance * UP
    return controls
