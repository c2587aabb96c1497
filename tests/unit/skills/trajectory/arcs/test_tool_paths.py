"""Tool paths: they are smooth, within the speed cap and on the curve, and both arms have the same times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.trajectory.arcs.bezier import arc_controls, arc_lengths
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.arcs.paths import (
    TOOL_ACCELERATION,
    SpeedLaw,
    after_lift,
    fold_duration,
    fold_paths,
    lifted,
    tool_paths,
)
from foldcell.skills.vocabulary import GraspId, GraspTrajectory

TOWEL = load_garment("medium_towel")
STEP = plan_folds(TOWEL.flat_state(0.58, 0.0), TOWEL).unwrap()[0]
CONTROLS = {s: arc_controls(f.start, f.end) for s, f in frames_of(STEP, TOWEL.material.thickness).items()}


@given(st.floats(0.01, 2.0), st.floats(0.05, 1.0))
@settings(max_examples=50)
def test_the_speed_law_covers_the_length_within_its_caps(length: float, cap: float) -> None:
    law = SpeedLaw.fastest(length, cap)
    t = np.linspace(0, law.duration, 2001)
    s = law.distance(t)
    v = np.gradient(s, t)
    a = np.gradient(v, t)
    assert s[0] == pytest.approx(0.0, abs=1e-12) and s[-1] == pytest.approx(length, rel=1e-12)
    assert v.min() > -1e-9 and v.max() <= cap * (1 + 1e-6)
    assert np.abs(a).max() <= TOOL_ACCELERATION * 1.01
    assert max(v[0], v[-1]) <= TOOL_ACCELERATION * t[1]
    tight = v.max() > 0.999 * cap or np.abs(a).max() > 0.98 * TOOL_ACCELERATION
    assert tight, "the fastest law reaches at least one cap"


@given(st.floats(0.05, 1.0), st.floats(0.3, 8.0))
@settings(max_examples=50)
def test_a_speed_law_of_given_duration_has_this_duration(length: float, duration: float) -> None:
    law = SpeedLaw.lasting(length, duration)
    assert law.duration == pytest.approx(duration, rel=1e-9)
    assert law.distance(np.array([duration]))[0] == pytest.approx(length, rel=1e-9)
    speed = np.gradient(law.distance(np.linspace(0, duration, 500)))
    assert (speed > -1e-12).all()


def test_the_law_of_the_fastest_duration_equals_the_fastest_law() -> None:
    law = SpeedLaw.fastest(0.6, 0.35)
    again = SpeedLaw.lasting(0.6, law.duration)
    assert (again.top, again.ramp) == pytest.approx((law.top, law.ramp))


def test_the_distance_is_the_integral_of_the_speed() -> None:
    law = SpeedLaw.fastest(0.6, 0.35)

    def speed(t: float) -> float:
        r = min(t, law.duration - t, law.ramp) / law.ramp
        return law.top * (3 * r * r - 2 * r**3)

    for t in (0.2, 0.9, law.duration - 0.1):
        exact, _ = quad(speed, 0, t, points=[law.ramp, law.duration - law.ramp], limit=200)
        assert law.distance(np.array([t]))[0] == pytest.approx(exact, abs=1e-9)


def test_paths_begin_at_the_grasp_rise_first_and_end_at_the_release() -> None:
    trajectory = GraspTrajectory(CONTROLS, fold_duration(CONTROLS, 0.35), "optimised", 0.0, 0.0)
    paths = tool_paths(trajectory, STEP)
    assert set(paths) == {GraspId.LEFT, GraspId.RIGHT}
    for i, path in paths.items():
        assert np.array_equal(path.position[0], CONTROLS[i][0])
        assert np.array_equal(path.position[-1], CONTROLS[i][-1])
        assert np.allclose(path.position[0, :2], STEP.grasps[i].point)
        assert np.allclose(path.position[-1], STEP.targets[i])
        first = path.position[:15, 2]
        assert (np.diff(first) > 0).all()
        assert np.linalg.norm(np.diff(path.position, axis=0), axis=1).max() <= 0.35 * np.diff(path.t).max() * 1.01
        assert (path.heading == STEP.grasps[i].heading).all()
    assert (paths[GraspId.LEFT].t == paths[GraspId.RIGHT].t).all()


def test_arms_with_different_arcs_are_always_at_the_same_share_of_their_arcs() -> None:
    longer = CONTROLS[GraspId.LEFT] * (1, 1, 2)
    controls = {GraspId.LEFT: longer, GraspId.RIGHT: CONTROLS[GraspId.RIGHT]}
    paths = fold_paths(controls, {GraspId.LEFT: 0.0, GraspId.RIGHT: 0.0}, fold_duration(controls, 0.35))
    travelled = {
        s: np.linalg.norm(np.diff(p.position, axis=0), axis=1).cumsum() / arc_lengths(controls[s])[1][-1]
        for s, p in paths.items()
    }
    assert np.allclose(travelled[GraspId.LEFT], travelled[GraspId.RIGHT], atol=1e-3)


def test_a_speed_cap_lengthens_the_path() -> None:
    trajectory = GraspTrajectory(CONTROLS, fold_duration(CONTROLS, 0.35), "optimised", 0.0, 0.0)
    slow, fast = (tool_paths(trajectory, STEP, max_speed=speed)[GraspId.LEFT] for speed in (0.1, 1.0))
    assert slow.t[-1] == pytest.approx(fold_duration(CONTROLS, 0.1))
    assert slow.t[-1] > 2 * trajectory.duration
    assert fast.t[-1] == pytest.approx(trajectory.duration)


def test_a_lift_goes_straight_up_to_where_the_path_begins() -> None:
    path = tool_paths(GraspTrajectory(CONTROLS, 4.0, "optimised", 0.0, 0.0), STEP)[GraspId.LEFT]
    raised = after_lift(path, 0.03)
    n = len(raised.t) - len(path.t)
    up = np.diff(raised.position[: n + 1], axis=0)
    assert raised.position[0] == pytest.approx(path.position[0] - [0.0, 0.0, 0.03])
    assert np.all(up[:, 2] > 0) and np.allclose(up[:, :2], 0.0, atol=1e-12)
    assert np.array_equal(raised.position[n:], path.position)
    # `lifted` moves the arc's start up from the grasp, and the offset fades out
    of_grasp = lifted(path, 0.03)
    assert of_grasp.position[0] == pytest.approx(path.position[0])
    assert of_grasp.position[n] == pytest.approx(path.position[0] + [0.0, 0.0, 0.03])
    assert of_grasp.position[-1] == pytest.approx(path.position[-1])
    assert after_lift(path, 0.0) is path and lifted(path, 0.0) is path
