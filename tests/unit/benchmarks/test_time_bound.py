"""Lower bounds of motion times against closed forms and timed motions."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.motion.bound import time_bound
from benchmarks.motion.folds import hermite, peak_shares
from robots.baxter.model import load_model
from skills.motion.timing.timing import free_motion, time_path

LIMITS = load_model().planning


@pytest.mark.parametrize("distance", [0.3, 1.5])
def test_the_time_bound_of_one_joint_has_a_closed_form(distance: float) -> None:
    """The bang-bang law: 2 sqrt(D / a), or D / v + v / a if it reaches the speed limit."""
    goal = np.zeros(14)
    goal[0] = distance
    v, a = LIMITS.velocity[0], LIMITS.acceleration[0]
    exact = distance / v + v / a if distance > v**2 / a else 2.0 * np.sqrt(distance / a)
    bound = time_bound(np.linspace(0.0, 1.0, 60)[:, None] * goal, LIMITS)
    assert bound.lower == pytest.approx(exact, rel=2e-3) and bound.lower <= bound.upper + 1e-9


def test_the_time_bound_includes_the_tool_speed_cap() -> None:
    goal = np.full(14, 0.05)
    length = np.linspace(0.0, 1.0, 60)[:, None]
    bound = time_bound(length * goal, LIMITS, lengths=length, speed=0.1)
    assert bound.lower == pytest.approx(10.0, rel=0.02)


def test_no_timed_motion_is_faster_than_the_bound() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 1.0, 60)[:, None]
    for _ in range(5):
        path = 0.5 * sum(
            rng.normal(0, 1, 14) * np.sin(w * np.pi * x + rng.uniform(0, 6.28, 14)) for w in (1.0, 2.0)
        )
        bound = time_bound(path, LIMITS)
        assert bound.gap < 0.01
        assert time_path(path, LIMITS).duration > bound.lower


def test_peak_shares_use_the_interpolant_sent_to_the_arms() -> None:
    rng = np.random.default_rng(4)
    motion = free_motion(*(rng.uniform(LIMITS.lower, LIMITS.upper) for _ in range(2)), LIMITS)
    t = rng.uniform(0.0, motion.duration, 50)
    q, qd, *_ = hermite(motion, t)
    for k, ti in enumerate(t):
        assert q[k] == pytest.approx(motion.at(float(ti))[0], abs=1e-12)
        assert qd[k] == pytest.approx(motion.at(float(ti))[1], abs=1e-12)
    assert 0.9 < max(peak_shares(motion, LIMITS)) <= 1.0
