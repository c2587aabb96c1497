"""Bezier curves, the paths of the held points (Farin 1988; section IV-A of the paper that README.md names)."""

from __future__ import annotations

from math import comb

import numpy as np

from foldcell.skills.vocabulary import Array

UP = np.array([0.0, 0.0, 1.0])
ORDER = 3  # of the arcs' curves
PAPER_H = 1.0 / 3.0  # height of the inner control points of the paper's first guess, in units of |P0 - Pn|
INTERVALS = 400  # intervals of the parameter in which lengths are measured


def bernstein(order: int, u: Array) -> Array:
    """Return the Bernstein polynomials B_k^n(u), (m, n + 1), of order n at parameters u (m,) from 0 to 1."""
    u = np.atleast_1d(np.asarray(u, dtype=float))[:, None]
    k = np.arange(order + 1)
    return np.array([comb(order, i) for i in k]) * u**k * (1.0 - u) ** (order - k)


def evaluate(control: Array, u: Array) -> Array:
    """Return the points (m, d) of the curve with control points (n + 1, d) at parameters u (m,)."""
    return bernstein(len(control) - 1, u) @ control


def arc_lengths(control: Array) -> tuple[Array, Array]:
    """Return parameters u (m,) and the length of the curve up to each (m,); interpolation then gives u for a
    length."""
    u = np.linspace(0.0, 1.0, INTERVALS + 1)
    # Two-point Gauss on each interval: exact for the speed of a straight cubic, error of 1e-9 for other curves.
    step, centre = 1.0 / INTERVALS, (u[1:] + u[:-1]) / 2
    derivative = (len(control) - 1) * np.diff(control, axis=0)
    speed = sum(
        np.linalg.norm(evaluate(derivative, centre + g * step / 2), axis=1) / 2 for g in (-(3**-0.5), 3**-0.5)
    )
    return u, np.concatenate([[0.0], np.cumsum(speed * step)])


def arc_controls(start: Array, end: Array, height: float = PAPER_H, skew: float = 0.0) -> Array:
    """Return the control points (4, 3) of an arc with `height` and `skew`, both in units of |P0 - Pn|: the inner
    points are evenly spaced, raised by `height` and shifted towards the end by `skew`. The default is the paper's
    first guess."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    chord = end - start
    distance = float(np.linalg.norm(chord))
    controls = start + np.linspace(0.0, 1.0, ORDER + 1)[:, None] * chord
    controls[1:-1] += skew * chord * (1.0, 1.0, 0.0) + height * distance * UP
    return controls
