"""Bezier curves against closed forms and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import BPoly

from foldcell.skills.trajectory.arcs.bezier import arc_controls, arc_lengths, bernstein, evaluate

seeds = st.integers(0, 2**32 - 1)


def controls(seed: int, order: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (order + 1, 3))


@given(seeds, st.integers(1, 6))
@settings(max_examples=30)
def test_evaluate_agrees_with_scipys_bernstein_polynomial(seed: int, order: int) -> None:
    control, u = controls(seed, order), np.linspace(0, 1, 17)
    assert np.allclose(evaluate(control, u), BPoly(control[:, None, :], [0, 1])(u), atol=1e-13)
    assert np.allclose(bernstein(order, u).sum(axis=1), 1.0)


@given(seeds)
@settings(max_examples=8)
def test_the_length_is_the_integral_of_the_speed(seed: int) -> None:
    control = controls(seed)
    derivative = 3 * np.diff(control, axis=0)
    exact, _ = quad(lambda u: float(np.linalg.norm(evaluate(derivative, u)[0])), 0, 1, epsabs=1e-12, limit=500)
    assert arc_lengths(control)[1][-1] == pytest.approx(exact, rel=1e-6)


def test_the_initial_controls_are_those_of_the_paper() -> None:
    start, end = np.array([0.7, 0.2, 0.0]), np.array([0.4, 0.2, 0.0])
    expected = [start, [0.6, 0.2, 0.1], [0.5, 0.2, 0.1], end]
    assert np.allclose(arc_controls(start, end), expected)


def test_skew_moves_the_arc_towards_its_end_and_height_raises_it() -> None:
    start, end = np.array([0.7, 0.2, 0.0]), np.array([0.4, 0.2, 0.01])
    low, high = (arc_controls(start, end, h, 0.0) for h in (0.3, 0.6))
    skewed = arc_controls(start, end, 0.3, 0.2)
    assert (high[1:3, 2] > low[1:3, 2]).all()
    assert np.allclose(skewed[1:3] - low[1:3], [[-0.06, 0, 0]] * 2, atol=1e-12)
    assert np.allclose(skewed[[0, 3]], [start, end])
