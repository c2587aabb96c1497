"""The course of the hands from readings with gaps, noise and errors."""

import numpy as np
import pytest

from foldcell.skills.cloth.predict import HANDS
from foldcell.skills.state_estimate.hand_course import FASTEST, HandCourse, held_until, without_gaps
from foldcell.skills.vocabulary import GraspId, tool_rotation

T = np.arange(200) / 100
CLOTH = 0.0022


def openings(rng, *changes):
    """Openings [m] with cloth, and from each time (s) on with another value."""
    opening = np.full(len(T), CLOTH)
    for at, value in changes:
        opening[at - 1e-9 <= T] = value
    return opening + rng.normal(0.0, 1e-4, len(T))


@pytest.mark.parametrize(
    ("changes", "until"),
    [
        ((), T[-1]),
        (((0.8, 0.0),), 0.8),  # the cloth slips out, and the pads close
        (((1.2, 0.020),), 1.2),  # the hand opens
        (((0.8, 0.0), (1.2, 0.020)), 0.8),
        (((0.8, CLOTH + 6e-4),), T[-1]),  # a wrinkle between the pads
        (((0.5, np.nan),), T[-1]),
    ],
)
def test_a_hand_holds_until_its_pads_close_or_open(changes, until):
    opening = openings(np.random.default_rng(3), *changes)
    found = held_until(T, opening, 0.0, 0.4)
    assert found == pytest.approx(until if np.isfinite(opening).all() else 0.49, abs=0.011)


def test_without_any_known_opening_the_hand_holds():
    assert held_until(T, np.full(len(T), np.nan), 0.0, 0.4) == T[-1]


def test_a_clock_that_was_set_ahead_moves_no_hand():
    stamps = np.r_[np.arange(10) / 100, 60.0 + np.arange(10) / 100]
    t = without_gaps(stamps, np.zeros((20, 14)))
    assert t[0] == 0.0 and np.diff(t).max() <= 0.5 and (np.diff(t) > 0.0).all()
    np.testing.assert_allclose(np.diff(t)[:8], 0.01)


def test_a_clock_that_was_set_back_moves_no_hand_faster_than_its_joints():
    """No reading is newer than the last one until the clock has caught up. The hands are elsewhere then."""
    q = np.zeros((20, 14))
    q[10:, 3] = 0.4
    t = without_gaps(np.arange(20) / 100, q)
    assert np.diff(t)[9] == pytest.approx(0.4 / FASTEST)
    np.testing.assert_allclose(np.delete(np.diff(t), 9), 0.01)


def test_the_frames_follow_the_readings_and_keep_the_tips_above_the_table():
    """The tool falls below the height at which it took the cloth, as a tip that yields on the table does."""
    height = -0.003 + 0.05 * np.sin(np.pi * T)  # below its start after 1 s
    heading = 0.4 * T
    grasp = GraspId.RIGHT
    course = HandCourse(
        T, {grasp: np.column_stack([0.6 + 0.1 * T, -0.2 * T, height])},
        {grasp: tool_rotation(heading, np.zeros(len(T)), np.zeros(len(T)))}, {grasp: 1.5},
    )  # fmt: skip
    position, rotation = course.sampled(1 / 60, {grasp: 0.001})
    hand, t = HANDS.index(grasp), np.arange(91) / 60
    assert position.shape == (91, 2, 3) and rotation.shape == (91, 2, 3, 3)
    np.testing.assert_allclose(position[:, hand, 0], 0.6 + 0.1 * t, atol=1e-9)
    np.testing.assert_allclose(position[:, hand, 2], 0.001 + 0.05 * np.maximum(np.sin(np.pi * t), 0.0), atol=1e-4)
    expected = tool_rotation(0.4 * t, np.zeros(91), np.zeros(91))
    np.testing.assert_allclose(rotation[:, hand], expected, atol=1e-9)
