"""Lower bounds of motion times against closed forms and timed motions."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.motion.bound import time_bound
from benchmarks.motion.folds import hermite, peak_shares
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Array
from foldcell.skills.motion.moves.rrt_connect import blend_corners
from foldcell.skills.motion.timing.timing import free_motion, join, time_path

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


def straight(rng: np.random.Generator, samples: int = 60) -> Array:
    """A line in joint space between two random configurations, evenly sampled."""
    a, b = (rng.uniform(-1.0, 1.0, 14) for _ in range(2))
    return a + np.linspace(0.0, 1.0, samples)[:, None] * (b - a)


@pytest.mark.parametrize("where", [0, 29, 59])
@pytest.mark.parametrize("distance", [0.0, 1e-9])
def test_repeated_samples_do_not_change_the_bound(where: int, distance: float) -> None:
    line = straight(np.random.default_rng(0))
    repeats = line[where] + distance * np.arange(1, 3)[:, None]
    bound = time_bound(np.insert(line, where + 1, repeats, axis=0), LIMITS)
    assert bound.lower == pytest.approx(time_bound(line, LIMITS).lower, rel=1e-6)


@pytest.mark.parametrize("repeated_at_the_turn", [False, True])
def test_a_path_that_turns_back_takes_the_bounds_of_its_parts(repeated_at_the_turn: bool) -> None:
    """Whatever turns back on a line is at rest there: three passes take three times as long as one."""
    line = straight(np.random.default_rng(1))
    skip = 0 if repeated_at_the_turn else 1
    bound = time_bound(np.vstack([line, line[::-1][skip:], line[skip:]]), LIMITS)
    assert bound.lower == pytest.approx(3.0 * time_bound(line, LIMITS).lower, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["nearly back", "one arm turns back", "blended corner", "stop on the way"])
def test_paths_on_which_the_arms_nearly_stop_have_a_bound(kind: str, seed: int) -> None:
    """The linear program's own solution is often at zero speed inside such a path, where a tangent is vertical."""
    rng = np.random.default_rng([5, seed])
    line = straight(rng)
    a, b = line[0], line[-1]
    goal = a + 0.01 * rng.normal(size=14)
    x = np.linspace(0.0, 1.0, 60)[1:, None]
    if kind == "nearly back":
        path = np.vstack([line, b + x * (goal - b)])
    elif kind == "one arm turns back":
        path = np.vstack([line, b + x * np.concatenate([(a - b)[:7], np.zeros(7)])])
    elif kind == "blended corner":
        path = blend_corners(np.array([a, b, a + 0.2 * rng.normal(size=14)]), 0.3)
    else:
        path = join([free_motion(a, b, LIMITS), free_motion(b, rng.uniform(-1.0, 1.0, 14), LIMITS)]).q
    bound = time_bound(path, LIMITS)
    assert 0.0 < bound.lower <= bound.upper + 1e-9 and bound.gap < 0.01
    assert time_path(path, LIMITS).duration > bound.lower


def test_a_path_that_stays_where_it_is_takes_no_time() -> None:
    bound = time_bound(np.ones((5, 14)), LIMITS)
    assert (bound.lower, bound.upper, bound.gap) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("path", [np.ones((1, 14)), np.full((5, 14), np.nan), np.full((5, 14), np.inf)])
def test_a_path_without_a_time_has_no_bound(path: Array) -> None:
    with pytest.raises(ValueError, match="two or more"):
        time_bound(path, LIMITS)


def test_peak_shares_use_the_interpolant_sent_to_the_arms() -> None:
    rng = np.random.default_rng(4)
    motion = free_motion(*(rng.uniform(LIMITS.lower, LIMITS.upper) for _ in range(2)), LIMITS)
    t = rng.uniform(0.0, motion.duration, 50)
    q, qd, *_ = hermite(motion, t)
    for k, ti in enumerate(t):
        assert q[k] == pytest.approx(motion.at(float(ti))[0], abs=1e-12)
        assert qd[k] == pytest.approx(motion.at(float(ti))[1], abs=1e-12)
    assert 0.9 < max(peak_shares(motion, LIMITS)) <= 1.0
