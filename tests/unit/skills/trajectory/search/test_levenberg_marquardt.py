"""The secant method against problems with known answers and against scipy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from foldcell.skills.trajectory.search.levenberg_marquardt import (
    SecantOptions,
    _broyden,
    secant_levenberg_marquardt,
)

FINE = SecantOptions(delta=1e-5, improvement_tolerance=0.0, max_evaluations=2000)


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def powell(x: np.ndarray) -> np.ndarray:
    """Powell's singular function: the Jacobian has rank 2 at the solution."""
    a, b, c, d = x
    return np.array([a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2])


def decay(x: np.ndarray) -> np.ndarray:
    """A fit with a residual that does not vanish."""
    t = np.linspace(0, 3, 25)
    data = 2.0 * np.exp(-1.3 * t) + 0.5 + 0.05 * np.sin(9 * t)
    return x[0] * np.exp(-x[1] * t) + x[2] - data


def minimise(problem, start, options=FINE):  # type: ignore[no-untyped-def]
    """Return the best point, and the number of points in each call of the problem."""
    batches: list[int] = []

    def residuals(points):  # type: ignore[no-untyped-def]
        batches.append(len(points))
        return [problem(p) for p in points]

    return secant_levenberg_marquardt(residuals, np.array(start), problem(np.array(start)), options), batches


@pytest.mark.parametrize(
    ("problem", "start", "tolerance"),
    [(rosenbrock, [-1.2, 1.0], 1e-6), (powell, [3.0, -1.0, 0.0, 1.0], 1e-6), (decay, [1.0, 1.0, 0.0], 1e-7)],
)
def test_the_optimum_agrees_with_scipy(problem, start, tolerance) -> None:  # type: ignore[no-untyped-def]
    ours, _ = minimise(problem, start)
    theirs = least_squares(problem, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert float(problem(ours) @ problem(ours)) / 2 <= theirs.cost + tolerance


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_linear_problem_is_solved_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(8, 3)) + 2 * np.eye(8, 3), rng.normal(size=8)
    result, _ = minimise(lambda x: A @ x - b, np.zeros(3), replace(FINE, delta=0.1))
    assert np.allclose(result, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-6)


def test_a_scalar_residual_of_many_variables_decreases() -> None:
    """As in the paper, the residual is one number whose square is minimised."""
    options = SecantOptions(delta=0.1, max_evaluations=80)
    result, _ = minimise(lambda x: np.array([1 + np.sum((x - 0.3) ** 2)]), np.zeros(6), options)
    assert np.sum((result - 0.3) ** 2) < 0.05


def test_broydens_update_is_the_smallest_that_satisfies_the_secant_equation() -> None:
    rng = np.random.default_rng(0)
    B, h, df = rng.normal(size=(4, 3)), rng.normal(size=3), rng.normal(size=4)
    new = _broyden(B, h, df)
    assert np.allclose(new @ h, df)
    across = np.cross(h, [0.3, -1.0, 0.2])
    assert np.allclose(new @ across, B @ across), "the update does not change directions across the step"


def test_the_budget_is_kept_and_no_step_makes_it_worse() -> None:
    costs = []
    for budget in (1, 4, 9, 20):
        result, batches = minimise(rosenbrock, [-1.2, 1.0], replace(FINE, max_evaluations=budget))
        costs.append(float(rosenbrock(result) @ rosenbrock(result)) / 2)
        assert sum(batches) <= budget
    assert costs == sorted(costs, reverse=True) and costs[-1] < 0.5 * costs[0]


def test_the_first_differences_are_one_batch() -> None:
    assert minimise(decay, [1.0, 1.0, 0.0])[1][:2] == [3, 1]


@pytest.mark.parametrize(
    "change", [{"improvement_tolerance": 0.5}, {"gradient_tolerance": 1e3}, {"step_tolerance": 1e-2}]
)
def test_each_tolerance_ends_the_search(change) -> None:  # type: ignore[no-untyped-def]
    assert len(minimise(decay, [1.0, 1.0, 0.0], replace(FINE, **change))[1]) < len(
        minimise(decay, [1.0, 1.0, 0.0])[1]
    )
