"""Alignment of two outlines of one shape, and their largest deviation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.skills.perception.registration.alignment import align, edge_deviation
from foldcell.skills.vocabulary import Array
from tests.scenes import place

# A folded shirt without symmetries. Corners counter-clockwise [m].
SHIRT = np.array([[0.45, -0.2], [0.75, -0.2], [0.75, 0.02], [0.65, 0.02], [0.65, 0.25], [0.45, 0.25]])
SQUARE = np.array([[0.4, -0.2], [0.8, -0.2], [0.8, 0.2], [0.4, 0.2]])


def turned(points: Array, x: float, y: float, degrees: float) -> Array:
    """The points turned about the middle of the table's work area and then moved."""
    return place(points - (0.6, 0.0), 0.6 + x, y, np.deg2rad(degrees))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.floats(-0.06, 0.06), st.floats(-0.06, 0.06), st.floats(-12.0, 12.0), st.booleans(), st.booleans(),
    st.integers(0, 5),
)  # fmt: skip
def test_a_known_motion_is_recovered(
    x: float, y: float, degrees: float, ours_backwards: bool, seen_backwards: bool, first: int
) -> None:
    """The accuracy is half a millimetre and a fifth of a degree, for any direction and starting point of the
    outlines."""
    moved = turned(SHIRT, x, y, degrees)
    ours = SHIRT[::-1] if ours_backwards else SHIRT
    seen = np.roll(moved[::-1] if seen_backwards else moved, first, axis=0)
    R, t = align(ours, seen)
    np.testing.assert_allclose(R @ R.T, np.eye(2), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert np.rad2deg(np.arctan2(R[1, 0], R[0, 0])) == pytest.approx(degrees, abs=0.2)
    assert np.abs(SHIRT @ R.T + t - moved).max() < 0.0007


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.0), (-0.25, 0.3), (0.0, -0.4)])
def test_large_motions_are_recovered(x: float, y: float) -> None:
    moved = turned(SHIRT, x, y, 5.0)
    R, t = align(SHIRT, moved)
    assert np.abs(SHIRT @ R.T + t - moved).max() < 0.0007


@pytest.mark.parametrize("out", [0.03, 0.06])
def test_a_corner_that_hangs_out_does_not_turn_the_rest(out: float) -> None:
    """Least squares would turn it. The alignment ignores distant points."""
    corner = np.array([[0.0, -out], [out, -out], [out, 0.08]]) + SQUARE[1]
    seen = turned(np.vstack([SQUARE[0], SQUARE[1] - (0.08, 0.0), corner, SQUARE[2:]]), 0.02, -0.03, 6.0)
    R, t = align(SQUARE, seen)
    assert np.abs((SQUARE @ R.T + t - turned(SQUARE, 0.02, -0.03, 6.0))[[0, 2, 3]]).max() < 0.002


def test_noise_of_an_outline_averages_out() -> None:
    """With pixels of 2 mm and about 1600 mm of edge, the mean is accurate to a fraction of a pixel."""
    rng = np.random.default_rng(0)
    side = np.linspace(0.0, 1.0, 100, endpoint=False)[:, None]
    fine = np.vstack([a + side * (b - a) for a, b in zip(SHIRT, np.roll(SHIRT, -1, axis=0), strict=True)])
    moved = turned(fine, 0.02, 0.01, 5.0)
    for _ in range(5):
        R, t = align(SHIRT, moved + rng.normal(0.0, 0.001, moved.shape))
        assert np.abs(fine @ R.T + t - moved).max() < 0.0015


def with_step(low: float, high: float, out: float) -> Array:
    """The square whose edge at y = 0.2 is moved outwards by `out` [m] between two places."""
    top = SQUARE[2, 1]
    notch = [[high, top], [high, top + out], [low, top + out], [low, top]]
    return np.vstack([SQUARE[:3], notch, SQUARE[3:]])


@pytest.mark.parametrize("out", [-0.03, -0.012, 0.012, 0.03])
@pytest.mark.parametrize("first", [0, 3, 5])
@pytest.mark.parametrize(("ours", "theirs"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_the_largest_deviation_has_a_sign_and_a_place(out: float, first: int, ours: int, theirs: int) -> None:
    """This holds for any starting point, also within the deviation, and for any direction of both outlines."""
    seen = np.roll(with_step(0.55, 0.65, out), first, axis=0)
    deviation, place = edge_deviation(SQUARE[::ours], seen[::theirs])
    assert deviation == pytest.approx(out, abs=0.003)
    assert 0.54 < place[0] < 0.66 and abs(place[1] - 0.2) < abs(out) + 0.004


@pytest.mark.parametrize("first", range(4))
def test_a_deviation_across_the_start_of_the_outline_is_found(first: int) -> None:
    """A corner lies 3 cm behind, and the outline starts there."""
    seen = SQUARE.copy()
    seen[first] += 0.03 * np.sign(np.array([0.6, 0.0]) - seen[first])
    seen = np.vstack([seen[first:], seen[:first]])
    deviation, place = edge_deviation(SQUARE, seen)
    assert deviation < -0.015 and np.linalg.norm(place - SQUARE[first]) < 0.07


def test_the_larger_of_two_deviations_is_returned() -> None:
    for large, small in ((0.03, -0.015), (-0.03, 0.015)):
        seen = with_step(0.55, 0.65, large)
        seen = np.vstack([seen, [[0.4, 0.05], [0.4 - small, 0.05], [0.4 - small, -0.05], [0.4, -0.05]]])
        deviation, place = edge_deviation(SQUARE, seen)
        assert deviation == pytest.approx(large, abs=0.003) and place[1] > 0.15


def test_only_deviations_near_given_places_count() -> None:
    """The edge at y = 0.2 is 3 cm off, the opposite one 1 cm."""
    seen = with_step(0.55, 0.65, 0.03)
    seen[seen[:, 1] < 0.0, 1] -= 0.01
    everywhere, opposite, nowhere = (
        edge_deviation(SQUARE, seen, near)[0] for near in np.array([[[0.6, 0.2]], [[0.6, -0.2]], [[0.6, 0.0]]])
    )
    assert (everywhere, opposite, nowhere) == pytest.approx((0.03, 0.01, 0.0), abs=0.003)


@pytest.mark.parametrize("out", [-0.03, 0.03])
def test_a_thread_or_a_slit_is_no_deviation(out: float) -> None:
    """A deviation over less than 3 cm of edge does not count. A thread that is 8 mm wide, with sides of 3 cm, has
    too short a base."""
    assert abs(edge_deviation(SQUARE, with_step(0.596, 0.604, out))[0]) < 0.02
    assert abs(edge_deviation(SQUARE, with_step(0.596, 0.604, 0.4 * out))[0]) < 0.004


def test_an_outline_has_no_deviation_from_itself() -> None:
    assert abs(edge_deviation(SHIRT, SHIRT)[0]) < 0.001
    assert abs(edge_deviation(SHIRT[::-1], np.roll(SHIRT, 2, axis=0))[0]) < 0.001


def test_a_shifted_outline_deviates_by_its_shift() -> None:
    assert abs(edge_deviation(SQUARE, SQUARE + np.array([0.0, 0.02]))[0]) == pytest.approx(0.02, abs=0.001)
    grown = (SQUARE - (0.6, 0.0)) * 1.1 + (0.6, 0.0)
    assert edge_deviation(SQUARE, grown)[0] == pytest.approx(0.02, abs=0.002)
    assert edge_deviation(grown, SQUARE)[0] == pytest.approx(-0.02, abs=0.002)
