import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.skills.perception.outline import interior_angles
from foldcell.skills.perception.registration.energy import (
    Boundary,
    EnergyWeights,
    contour_terms,
    solve_damped,
)

SQUARE = np.array([[0.2, 0.3], [-0.2, 0.3], [-0.2, -0.3], [0.2, -0.3]])


def blob(n=24, seed=0):
    rng = np.random.default_rng(seed)
    a = np.arange(n) * 2 * np.pi / n
    r = 0.3 + 0.05 * np.cos(3 * a) + 0.01 * rng.standard_normal(n)
    return np.stack([r * np.cos(a), r * np.sin(a)], axis=1)


def jacobian(terms):
    """Jacobian (m, 2 n) of the residuals; columns are the x and y of each vertex in turn."""
    J = np.zeros((len(terms.r), terms.count, 2))
    for k in range(3):
        J[np.arange(len(terms.r)), terms.vertex[:, k]] += terms.gradient[:, k]
    return J.reshape(len(terms.r), 2 * terms.count)


def test_the_energy_is_the_sum_of_the_papers_terms():
    """The terms are written out as in the paper, with an independent distance field (shapely)."""
    from shapely import LinearRing, Point

    target, reference = blob(80), blob(20, 1) * 1.02
    X = reference + 0.01 * np.random.default_rng(4).standard_normal(reference.shape)
    ring, kappa, beta, n = LinearRing(target), 0.3, 0.2, len(X)
    fit = stretch = bend = 0.0
    for i in range(n):
        a, b, ra, rb = X[i], X[(i + 1) % n], reference[i], reference[(i + 1) % n]
        length, rest = np.linalg.norm(b - a), np.linalg.norm(rb - ra)
        fit += ring.distance(Point((a + b) / 2)) ** 2 * length
        stretch += 0.5 * (length / rest - 1) ** 2 * rest

        def angle(P, i=i):
            u, v = P[(i + 1) % n] - P[i], P[i - 1] - P[i]
            return (np.arctan2(v[1], v[0]) - np.arctan2(u[1], u[0])) % (2 * np.pi)

        mean = 0.5 * (rest + np.linalg.norm(ra - reference[i - 1]))
        bend += 0.5 * (angle(X) / angle(reference) - 1) ** 2 * mean
    weights = EnergyWeights(kappa=kappa, beta=beta, cover=0.0)
    terms = contour_terms(X, reference, Boundary(target, step=0.0005), weights)
    assert terms.energy == pytest.approx(fit + kappa * stretch + beta * bend, rel=2e-3)


@given(st.integers(0, 10_000))
def test_the_jacobian_agrees_with_finite_differences(seed):
    """The target is a square, whose distance field is smooth along its sides."""
    rng = np.random.default_rng(seed)
    boundary = Boundary(SQUARE, step=0.0005, sample_step=0.02)
    reference = np.array([[0.21, 0.15], [0.19, 0.31], [-0.19, 0.29], [-0.21, 0.0], [-0.18, -0.31], [0.2, -0.3]])
    X = reference + 0.004 * rng.standard_normal(reference.shape)
    weights = EnergyWeights(kappa=0.1, beta=0.1, cover=1.0)
    J = jacobian(contour_terms(X, reference, boundary, weights))
    step = 1e-7
    worst = 0
    for k in range(X.size):
        d = np.zeros(X.size)
        d[k] = step
        up = contour_terms(X + d.reshape(X.shape), reference, boundary, weights).r
        down = contour_terms(X - d.reshape(X.shape), reference, boundary, weights).r
        worst += np.count_nonzero(np.abs((up - down) / (2 * step) - J[:, k]) > 1e-3 + 1e-3 * np.abs(J[:, k]))
    # A nearest point may jump between the two evaluations, but only rarely.
    assert worst <= 0.01 * J.size


@pytest.mark.parametrize("n", [3, 5, 40])
def test_the_normal_equations_and_their_solution_agree_with_dense_algebra(n):
    terms = contour_terms(blob(n, 2) * 1.03, blob(n), Boundary(blob(80)), EnergyWeights())
    J, (A, g) = jacobian(terms), terms.normal_equations()
    assert np.allclose(A, J.T @ J, rtol=1e-12, atol=1e-15) and np.allclose(g, J.T @ terms.r, atol=1e-15)
    x = solve_damped(A, g, 1e-4)
    assert np.allclose(x, np.linalg.solve(A + 1e-4 * np.eye(2 * n), g), rtol=1e-8)


def test_the_nearest_boundary_point_agrees_with_a_dense_search():
    boundary, x = Boundary(blob(80)), np.random.default_rng(5).uniform(-0.5, 0.5, (200, 2))
    distance, index = boundary.nearest(x)
    away = np.linalg.norm(x[:, None] - boundary.points, axis=2)
    assert np.allclose(distance, away.min(axis=1)) and np.array_equal(index, away.argmin(axis=1))


def test_interior_angles_sum_to_n_minus_2_pi_and_reflex_angles_exceed_pi():
    arrow = np.array([[0.0, 0.0], [0.2, -0.2], [0.0, 0.4], [-0.2, -0.2]])
    angles = interior_angles(arrow)
    assert angles.sum() == pytest.approx(2 * np.pi)
    assert angles[0] > np.pi
    assert np.allclose(interior_angles(SQUARE), np.pi / 2)


def test_the_distance_to_the_boundary_is_signed():
    boundary = Boundary(SQUARE, step=0.0005)
    x = np.array([[0.0, 0.31], [0.0, 0.0], [0.25, 0.0], [0.0, -0.2995]])
    distance, gradient = boundary.distance(x)
    assert np.allclose(distance, [0.01, -0.2, 0.05, -0.0005], atol=1e-4)
    assert np.allclose(gradient[0], [0, 1], atol=0.1) and np.allclose(gradient[2], [1, 0], atol=0.01)
