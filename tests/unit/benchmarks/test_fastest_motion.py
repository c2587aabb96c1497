"""Durations of the fastest motions against closed forms and timed motions."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.motion.folds import fastest, hermite, peak_shares
from foldcell.robots.baxter.robot import load_model
from foldcell.skills.motion.timing.timing import free_motion, time_path

LIMITS = load_model().planning


@pytest.mark.parametrize("distance", [0.3, 1.5])
def test_the_fastest_motion_of_one_joint_has_a_closed_form(distance: float) -> None:
    """The bang-bang law: 2 sqrt(D / a), or D / v + v / a if it reaches the speed limit."""
    goal = np.zeros(14)
    goal[0] = distance
    v, a = LIMITS.velocity[0], LIMITS.acceleration[0]
    exact = distance / v + v / a if distance > v**2 / a else 2.0 * np.sqrt(distance / a)
    assert fastest(np.linspace(0.0, 1.0, 60)[:, None] * goal, LIMITS) == pytest.approx(exact, rel=2e-3)


def test_the_fastest_motion_keeps_the_tool_speed() -> None:
    goal = np.full(14, 0.05)
    length = np.linspace(0.0, 1.0, 60)[:, None]
    assert fastest(length * goal, LIMITS, length, 0.1) == pytest.approx(10.0, rel=0.02)


def test_no_timed_motion_is_faster() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 60)[:, None]
    for _ in range(5):
        path = 0.5 * sum(
            rng.normal(0, 1, 14) * np.sin(w * np.pi * x + rng.uniform(0, 6.28, 14)) for w in (1.0, 2.0)
        )
        assert time_path(path, LIMITS).duration > fastest(path, LIMITS)


def test_peak_shares_use_the_interpolant_sent_to_the_arms() -> None:
    rng = np.random.default_rng(4)
    motion = free_motion(*(rng.uniform(LIMITS.lower, LIMITS.upper) for _ in range(2)), LIMITS)
    t = rng.uniform(0.0, motion.duration, 50)
    q, qd, *_ = hermite(motion, t)
    for k, ti in enumerate(t):
        assert q[k] == pytest.approx(motion.at(float(ti))[0], abs=1e-12)
        assert qd[k] == pytest.approx(motion.at(float(ti))[1], abs=1e-12)
    assert 0.9 < max(peak_shares(motion, LIMITS)) <= 1.0
