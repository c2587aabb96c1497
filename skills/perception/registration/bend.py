"""Locates a blunt corner, such as a shoulder or the armpit of a vest, by the bend of the outline.

Near a blunt corner the boundary is modelled as two slightly curved lines that meet at an angle: in a frame along
the boundary, y(x) = a + b x + c max(x, 0) + d max(x, 0)^2 + e min(x, 0)^2, where x = 0 is the corner. For each
place of the corner, the coefficients are integrated out (Bayesian linear regression; Bishop, Pattern Recognition
and Machine Learning, section 3.5), which gives the likelihood of the place. Its product with the probability that
the registration gives to the place is the posterior. A clear bend has a narrow posterior. If the boundary is
nearly straight, the corner stays where the registration put it, with the uncertainty of the registration.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.energy import Boundary

PLACE_SIGMA = 0.006  # standard deviation of the place that the registration gives, along the boundary [m]
_SEARCH = 0.035  # maximum displacement [m]
_REACH = 0.05  # length of boundary that is used on each side of all places tried [m]
_MARGIN = 0.012  # distance that is kept from the next corner [m]
_NOISE = 0.0004  # standard deviation of the boundary's points [m]
_CORRELATION = 0.02  # length over which the errors of these points are correlated [m]
_CURVATURE = 1.5  # standard deviation of d and e [1/m]
_TURN_SIGMA = 0.25  # standard deviation of the corner's turn, around the turn in the template [rad]
_FREEDOM = 8.0  # degrees of freedom of the t-distribution that replaces the normal one: outlines have wrinkles


def locate_bend(boundary: Boundary, place: Array, before: float, after: float, turn: float) -> tuple[Array, float]:
    """Find a blunt corner near `place` (2,) [m]. Return its place (2,) on the boundary, and the standard deviation
    of this place along the boundary [m].

    before, after: lengths of boundary to the previous and to the next corner [m]. turn: angle by which the
    template turns at the corner, positive to the left [rad].
    """
    points = boundary.points
    step = boundary.length / len(points)
    start = int(boundary.nearest(place[None])[1][0])
    back, ahead = (min(_SEARCH + _REACH, max(length - _MARGIN, 0.0)) for length in (before, after))
    shifts = np.arange(-int(min(_SEARCH, 0.5 * back) / step), int(min(_SEARCH, 0.5 * ahead) / step) + 1)
    first, last = int(back / step), int(ahead / step)
    if min(first, last) < 4:
        return points[start].copy(), PLACE_SIGMA
    window = points[(start + np.arange(-first, last + 1)) % len(points)]
    offset = shifts * step
    log_p = _log_likelihood(window, first + shifts, turn, step) - 0.5 * (offset / PLACE_SIGMA) ** 2
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    mean = float(p @ offset)
    sigma = float(np.sqrt(p @ (offset - mean) ** 2 + step**2 / 12))
    return points[(start + round(mean / step)) % len(points)].copy(), sigma


def _log_likelihood(window: Array, corners: NDArray[np.intp], turn: float, step: float) -> Array:
    """Logarithm of the likelihood (m,) that the corner is at each of the indices `corners` (m,) of the boundary's
    points `window` (n, 2), up to a constant."""
    along = window[-1] - window[0]
    along = along / np.linalg.norm(along)
    x, y = (window - window[0]) @ along, (window - window[0]) @ np.array([-along[1], along[0]])
    information = step / _CORRELATION / _NOISE**2  # of one point, as neighbours are correlated
    precision = np.array([0.0, 0.0, 1 / _TURN_SIGMA**2, *2 * (1 / _CURVATURE**2,)])
    expected = np.array([0.0, 0.0, np.tan(turn), 0.0, 0.0])
    z = x - x[corners, None]
    right, left = np.maximum(z, 0.0), np.minimum(z, 0.0)
    A = np.stack([np.ones_like(z), z, right, right**2, left**2], axis=2)  # (m, n, 5)
    H = information * np.matmul(A.transpose(0, 2, 1), A) + np.diag(precision)
    g = information * np.matmul(A.transpose(0, 2, 1), y[:, None])[..., 0] + precision * expected
    fitted = np.linalg.solve(H, g[..., None])[..., 0]
    residual = y - (A * fitted[:, None]).sum(axis=2)
    misfit = information * (residual**2).sum(axis=1) + ((fitted - expected) ** 2 * precision).sum(axis=1)
    independent = len(window) * step / _CORRELATION
    log_volume = np.linalg.slogdet(H)[1]
    log_tail = -0.5 * (independent + _FREEDOM) * np.log1p(misfit / _FREEDOM)
    return np.asarray(log_tail - 0.5 * log_volume)
