"""The model of a wedge of table between two pieces of cloth, against closed forms and drawn strips."""

import numpy as np
import pytest

from foldcell.skills.perception.registration.details.wedge import Strip, WedgePrior, _model, _residuals, fit_wedge

S, V = np.arange(-0.03, 0.06, 0.0025), np.arange(-0.02, 0.0201, 0.00125)
TABLE = np.array([0.9, 0.3, -0.2])
CLOTH = np.array([0.1, 0.1, 0.2])
ROUND = 0.002
PRIOR = WedgePrior(0.02, 0.15, 0.7, 0.5)
TRUTH = np.array([0.004, 0.001, 0.03, 0.15, 0.3, 0.0018, 0.2])


def strip(parameters, noise=0.0):
    empty = Strip(S, V, np.zeros((len(S), len(V), 3)), TABLE, np.tile(CLOTH, (len(S), 1)), ROUND)
    drawn = _model(parameters, empty)[0]
    drawn = drawn + np.random.default_rng(0).normal(0.0, noise, drawn.shape)
    return Strip(S, V, drawn, TABLE, empty.cloth, ROUND)


def test_the_derivatives_are_those_of_the_model():
    seen = strip(TRUTH)
    _, J = _model(TRUTH, seen)
    for k, step in enumerate([1e-6, 1e-6, 1e-5, 1e-5, 1e-5, 1e-7, 1e-4]):
        low, high = TRUTH.copy(), TRUTH.copy()
        low[k] -= step
        high[k] += step
        numeric = (_model(high, seen)[0] - _model(low, seen)[0]) / (2 * step)
        np.testing.assert_allclose(J[..., k], numeric, atol=2e-3 * np.abs(numeric).max())


def test_the_shown_area_of_table_is_the_width_of_the_gap():
    """Summed over a row, the blur has no effect."""
    wedge = TRUTH.copy()
    wedge[4] = 0.0
    seen = strip(wedge)
    u = np.maximum(S - wedge[0], 0.0)
    width = wedge[3] * np.sqrt(u * u + 2 * ROUND * u) + wedge[6] * u * u
    area = seen.colours.sum(axis=1) * (V[1] - V[0])
    np.testing.assert_allclose(area, width[:, None] * (TABLE - CLOTH), atol=1e-5)


def test_beyond_the_tip_only_cloth_is_seen():
    assert np.abs(strip(TRUTH).colours[TRUTH[0] > S]).max() < 1e-4


@pytest.mark.parametrize("start", [-0.02, 0.015])
def test_the_tip_is_found_in_noise(start):
    first = np.array([start, 0.0, 0.0, 0.12, 0.2, 0.002, 0.0])
    wedge = fit_wedge(strip(TRUTH, 0.05), [first], PRIOR, 1)
    assert abs(wedge.parameters[0] - TRUTH[0]) < 0.003
    assert abs(wedge.parameters[1] - TRUTH[1]) < 0.001
    assert np.sqrt(wedge.covariance[0, 0]) < 0.006
    assert wedge.misfit == pytest.approx(0.05 * np.sqrt(3), rel=0.15)


def test_a_narrower_gap_has_a_less_certain_tip():
    sigmas = []
    for growth in (0.3, 0.15, 0.07):
        true = TRUTH.copy()
        true[3], true[6] = growth, 0.0
        sigmas.append(fit_wedge(strip(true, 0.05), [true], PRIOR, 1).covariance[0, 0])
    assert sigmas == sorted(sigmas)


def test_the_prior_enters_the_cost():
    seen = strip(TRUTH)
    r, J, cost = _residuals(TRUTH, seen, PRIOR)
    assert r.shape == (J.shape[0],)
    expected = 12.0 * ((0.004 / 0.02) ** 2 + 0.25**2 + (0.2 / 0.5) ** 2)
    assert cost == pytest.approx(expected, rel=1e-6)


def test_of_a_gap_that_lies_beside_the_strip_only_what_the_prior_knows_is_known():
    closed = Strip(S - 0.5, V, np.zeros((len(S), len(V), 3)), TABLE, np.tile(CLOTH, (len(S), 1)), ROUND)
    start = np.array([0.0, 0.0, 1.0, 0.15, 0.2, 0.002, 0.0])
    sigmas = np.sqrt(np.diag(fit_wedge(closed, [start], PRIOR, 1).covariance))
    assert sigmas[0] == pytest.approx(PRIOR.place, rel=0.01) and sigmas[5] > 1.0
