"""The jerk limiter: it keeps its limits for any goal and reaches the goal."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.robots.errors import InternalError
from foldcell.skills.motion.timing.jerk_limiter import JerkLimiter, step_towards

DT, SPEED, ACCELERATION, JERK = 0.01, 0.4, 0.6, 12.0


def followed(goals: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    state, way = JerkLimiter(0.0), []
    for goal, speed in zip(goals, speeds, strict=True):
        state = step_towards(
            state, float(goal), float(speed), DT, speed=SPEED, acceleration=ACCELERATION, jerk=JERK
        )
        way.append((state.position, state.velocity, state.acceleration))
    return np.array(way)


def test_a_goal_that_jumps_is_reached_without_a_jump() -> None:
    rng = np.random.default_rng(0)
    goals = np.repeat(rng.uniform(-0.01, 0.01, 12), 60)
    x, v, a = followed(goals, np.zeros(len(goals))).T
    assert np.abs(a).max() <= ACCELERATION + 1e-9 and np.abs(np.diff(a)).max() <= JERK * DT + 1e-9
    assert np.abs(np.diff(x) / DT - (v[1:] + v[:-1]) / 2).max() < 1e-3
    assert x[59::60] == pytest.approx(goals[59::60], abs=1e-6)


def test_a_goal_with_constant_speed_is_followed_one_tick_behind() -> None:
    t = DT * np.arange(1, 200)
    x, v, _ = followed(0.05 * t, np.full(len(t), 0.05)).T
    assert x[-1] == pytest.approx(0.05 * t[-1], abs=0.05 * DT) and v[-1] == pytest.approx(0.05, abs=1e-3)


def test_a_goal_that_stops_is_overshot_only_a_little() -> None:
    """With only the jerk limit, the smallest overshoot from speed v is about sqrt(v^3 / j)."""
    t = DT * np.arange(1, 200)
    goal = np.minimum(0.02 * t, 0.02)
    x, _, _ = followed(goal, np.where(t < 1.0, 0.02, 0.0)).T
    assert x.max() - 0.02 < 1.5 * np.sqrt(0.02**3 / JERK)
    assert x[-1] == pytest.approx(0.02, abs=1e-6)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["state", "goal", "goal_speed", "dt", "speed", "acceleration", "jerk"])
def test_values_that_are_not_finite_are_refused(name: str, wrong: float) -> None:
    """A speed that is not a number would otherwise count as full speed, and such a time would crash Ruckig."""
    values = {"goal": 0.1, "goal_speed": 0.0, "dt": DT, "speed": SPEED, "acceleration": ACCELERATION, "jerk": JERK}
    state = JerkLimiter(0.0, wrong) if name == "state" else JerkLimiter(0.0)
    values |= {} if name == "state" else {name: wrong}
    with pytest.raises(InternalError, match=str(wrong)) as error:
        step_towards(state, **values)
    assert error.value.values and error.value.hint


@pytest.mark.parametrize(
    "wrong",
    [{"dt": 0.0}, {"speed": 0.0}, {"jerk": -1.0}, {"acceleration": 0.0}, {"goal": 1e300}, {"speed": 1e-300}],
)
def test_a_goal_that_no_motion_reaches_is_refused(wrong: dict[str, float]) -> None:
    values = {"goal": 0.1, "goal_speed": 0.0, "dt": DT, "speed": SPEED, "acceleration": ACCELERATION, "jerk": JERK}
    with pytest.raises(InternalError) as error:
        step_towards(JerkLimiter(0.0), **(values | wrong))
    assert error.value.values["goal"] == (values | wrong)["goal"]
