"""Clipping of set-points to limits and reach, and the return from outside the limits."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from foldcell.robots.model import JointLimits
from foldcell.robots.ports import Array
from foldcell.robots.setpoint import clip_setpoint

UPPER = np.linspace(0.5, 3.0, 14)
VELOCITY = np.linspace(1.0, 4.0, 14)
LIMITS = JointLimits(-0.8 * UPPER, UPPER, VELOCITY, VELOCITY * 5.0, VELOCITY * 50.0)
REACH = VELOCITY * 0.040
"""Largest step of a set-point by docs/do/safety.md: the motion of the joints in 40 ms at full speed [rad]."""
ROUNDING = 1e-12


def vectors(least: float, most: float) -> st.SearchStrategy[Array]:
    return arrays(np.float64, 14, elements=st.floats(least, most))


def between(lower: Array, upper: Array) -> st.SearchStrategy[Array]:
    return vectors(0.0, 1.0).map(lambda share: np.clip(lower + share * (upper - lower), lower, upper))


inside = between(LIMITS.lower, LIMITS.upper)
anywhere = vectors(-1e6, 1e6)


far_out = between(LIMITS.lower - 20.0 * REACH, LIMITS.upper + 20.0 * REACH)


def outside(q: Array) -> Array:
    """Distance of each joint from its range (14,) [rad]."""
    return np.maximum(np.maximum(LIMITS.lower - q, q - LIMITS.upper), 0.0)


@given(q=anywhere | inside, qd=anywhere, before=inside)
def test_the_set_point_stays_within_limits_and_reach(q: Array, qd: Array, before: Array) -> None:
    sent = clip_setpoint(q, qd, before, before, LIMITS, 1.0)
    assert np.all((sent.q >= LIMITS.lower) & (sent.q <= LIMITS.upper))
    assert np.all(np.abs(sent.q - before) <= REACH + ROUNDING)
    assert np.all(np.abs(sent.qd) <= LIMITS.velocity)
    assert sent.stamp == 1.0


@given(q=anywhere | inside | far_out, qd=anywhere, before=far_out)
def test_a_set_point_outside_the_limits_never_jumps_or_moves_further_out(
    q: Array, qd: Array, before: Array
) -> None:
    sent = clip_setpoint(q, qd, before, before, LIMITS, 1.0)
    assert np.all(np.abs(sent.q - before) <= REACH + ROUNDING)
    assert np.all(outside(sent.q) <= outside(before) + ROUNDING)
    assert sent.clipped is not (np.array_equal(sent.q, q) and np.array_equal(sent.qd, qd))


@given(goal=inside, before=far_out)
def test_a_set_point_outside_the_limits_returns_inside(goal: Array, before: Array) -> None:
    """The set-point returns directly, by at most one step each time."""
    steps = int(np.ceil(np.max(np.abs(goal - before) / REACH))) + 1
    for _ in range(steps):
        sent = clip_setpoint(goal, np.zeros(14), before, before, LIMITS, 0.0).q
        nearer = np.minimum(np.abs(goal - before), REACH)
        np.testing.assert_allclose(np.abs(sent - before), nearer, rtol=0, atol=ROUNDING)
        before = sent
    np.testing.assert_allclose(before, goal, rtol=0, atol=ROUNDING)


@given(before=far_out)
def test_the_present_position_is_always_allowed(before: Array) -> None:
    sent = clip_setpoint(before, np.zeros(14), before, before, LIMITS, 0.0)
    np.testing.assert_array_equal(sent.q, before)
    assert not sent.clipped


@given(before=inside, share=vectors(-0.99, 0.99), qd=between(-VELOCITY, VELOCITY))
def test_an_allowed_set_point_is_sent_unchanged(before: Array, share: Array, qd: Array) -> None:
    q = np.clip(before + share * REACH, LIMITS.lower, LIMITS.upper)
    sent = clip_setpoint(q, qd, before, before, LIMITS, 0.0)
    np.testing.assert_array_equal(sent.q, q)
    np.testing.assert_array_equal(sent.qd, qd)
    assert not sent.clipped


@given(q=anywhere, before=inside)
def test_the_set_point_moves_towards_the_requested_one(q: Array, before: Array) -> None:
    sent = clip_setpoint(q, np.zeros(14), before, before, LIMITS, 0.0)
    assert np.all(np.sign(q - before) * (sent.q - before) >= -ROUNDING)
    nearer = np.minimum(np.abs(q - before), REACH)
    free = (sent.q > LIMITS.lower) & (sent.q < LIMITS.upper)
    np.testing.assert_allclose(np.abs(sent.q - before)[free], nearer[free], atol=ROUNDING)


@given(q=anywhere | inside | far_out, before=far_out, stands=far_out)
def test_straying_joints_get_set_points_near_their_position_or_last_set_point(
    q: Array, before: Array, stands: Array
) -> None:
    sent = clip_setpoint(q, np.zeros(14), before, stands, LIMITS, 0.0)
    off = np.maximum(np.minimum(before, stands) - sent.q, sent.q - np.maximum(before, stands))
    assert np.all(off <= REACH + ROUNDING)
    assert np.all(outside(sent.q) <= outside(before) + ROUNDING)


@given(before=inside, stands=inside)
def test_blocked_joints_are_held_at_their_position(before: Array, stands: Array) -> None:
    sent = clip_setpoint(stands, np.zeros(14), before, stands, LIMITS, 0.0)
    np.testing.assert_array_equal(sent.q, stands)
    assert not sent.clipped
