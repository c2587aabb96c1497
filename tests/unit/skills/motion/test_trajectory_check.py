"""Validation of a trajectory: every kind of error is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import ArmTrajectory
from foldcell.skills.motion.moves.free_motion import plan_free_motion
from foldcell.skills.motion.timing.timing import free_motion
from foldcell.skills.motion.validation.collision import CollisionChecker, Contact
from foldcell.skills.motion.validation.trajectory_check import check_trajectory, contact_along
from foldcell.skills.vocabulary import Table

MODEL = load_model()
TABLE = Table(-0.10, (0.20, 1.10), (-0.75, 0.75))


@pytest.fixture(scope="module")
def checker():
    return CollisionChecker(MODEL, TABLE)


@pytest.fixture(scope="module")
def good():
    q1 = MODEL.q_park + np.array([0.2, 0.1, 0.0, -0.3, 0.0, 0.2, 0.1] + [0.0] * 7)
    return free_motion(MODEL.q_park, q1, MODEL.planning)


def judged(checker, trajectory, q_now=None, **options):
    start = trajectory.q[0] if q_now is None else q_now
    return check_trajectory(MODEL, checker, trajectory, start, MODEL.planning, **options)


def altered(trajectory, name, index, value):
    a = np.array(getattr(trajectory, name))
    a[index] = value
    return replace(trajectory, **{name: a})


def test_a_good_trajectory_passes_with_its_peak_loads(checker, good):
    share = judged(checker, good).unwrap()
    assert 0.3 < share.worst <= 1.0


@pytest.mark.parametrize("name", ["t", "q", "qd", "qdd"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(checker, good, name, value):
    index = 7 if name == "t" else (7, 3)
    result = judged(checker, altered(good, name, index, value), good.q[0])
    assert result.failure is not None and result.failure.kind is FailureKind.LIMIT_EXCEEDED


def test_an_arm_state_that_is_not_finite_is_a_start_mismatch(checker, good):
    q = np.array(good.q[0])
    q[4] = np.nan
    assert judged(checker, good, q).failure.kind is FailureKind.START_MISMATCH


@pytest.mark.parametrize(("off", "passes"), [(0.9, True), (-0.9, True), (1.1, False), (-1.1, False)])
def test_the_trajectory_must_start_at_the_arms_position(checker, good, off, passes):
    q = np.array(good.q[0])
    q[10] -= np.deg2rad(off)
    result = judged(checker, good, q)
    assert result.ok is passes
    if not passes:
        assert result.failure.kind is FailureKind.START_MISMATCH
        assert "right_e1" in result.failure.what


def test_sample_times_must_rise_from_zero_in_small_steps(checker, good):
    assert not judged(checker, altered(good, "t", 5, good.t[4])).ok
    assert not judged(checker, replace(good, t=good.t + 0.1)).ok
    twice = ArmTrajectory(*(np.insert(a, 8, a[8], axis=0) for a in (good.t, good.q, good.qd, good.qdd)))
    assert "rise" in judged(checker, twice).failure.what, "two samples at the same time are refused"
    sparse = ArmTrajectory(good.t[::3], good.q[::3], good.qd[::3], good.qdd[::3])
    assert "far apart" in judged(checker, sparse).failure.what


def test_a_trajectory_must_begin_and_end_at_rest(checker, good):
    cut = ArmTrajectory(good.t[:30], good.q[:30], good.qd[:30], good.qdd[:30])
    assert "rest" in judged(checker, cut).failure.what
    for end, speed in ((0, 0.01), (0, -0.01), (-1, 0.01), (-1, -0.01)):
        moving = judged(checker, altered(good, "qd", (end, 3), speed), good.q[0])
        assert "rest" in moving.failure.what, "a motion in either direction is refused"


@pytest.mark.parametrize("name", ["q", "qd", "qdd"])
@pytest.mark.parametrize("part", [np.s_[:-1], np.s_[:, :13]])
def test_arrays_of_different_lengths_are_refused(checker, good, name, part):
    result = judged(checker, replace(good, **{name: getattr(good, name)[part]}), good.q[0])
    assert "do not fit" in result.failure.what


@pytest.mark.parametrize("faster", [1.05, 2.0])
def test_a_trajectory_played_too_fast_is_refused(checker, good, faster):
    quick = ArmTrajectory(good.t / faster, good.q, good.qd * faster, good.qdd * faster**2)
    failure = judged(checker, quick).failure
    assert failure.kind is FailureKind.LIMIT_EXCEEDED
    assert failure.values["jerk_share"] == pytest.approx(0.98 * faster**3, rel=0.02)


def test_samples_that_do_not_fit_their_velocities_are_refused(checker, good):
    """A position jumps without a matching velocity, so the interpolant would oscillate."""
    assert not judged(checker, altered(good, "q", (len(good.t) // 2, 2), good.q[len(good.t) // 2, 2] + 0.01)).ok


def test_a_joint_beyond_its_range_is_reported_by_name(checker):
    q1 = np.array(MODEL.q_park)
    q1[5] = MODEL.planning.upper[5] + 0.05
    failure = judged(checker, free_motion(MODEL.q_park, q1, MODEL.planning)).failure
    assert failure.kind is FailureKind.LIMIT_EXCEEDED and "left_w1" in failure.what


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_arms_outside_a_joint_range_may_return_but_not_move_further_out(checker, side):
    """The planning range is narrower than the joint's range. The test uses the left wrist roll, which causes no
    collisions."""
    limits, wrist = MODEL.planning, 6
    bound = limits.lower[wrist] if side < 0.0 else limits.upper[wrist]
    outside, further = np.array(MODEL.q_park), np.array(MODEL.q_park)
    outside[wrist], further[wrist] = bound + 0.01 * side, bound + 0.02 * side
    assert judged(checker, free_motion(outside, MODEL.q_park, limits)).ok
    for start in (outside, MODEL.q_park):
        failure = judged(checker, free_motion(start, further, limits)).failure
        assert failure.kind is FailureKind.LIMIT_EXCEEDED and "left_w2" in failure.what


def test_a_trajectory_through_the_table_is_refused(checker):
    q1 = np.array(MODEL.q_park)
    q1[[0, 7]] += [-0.5, 0.5]
    q1[[1, 8]] += 0.8
    motion = free_motion(MODEL.q_park, q1, MODEL.planning)
    failure = judged(checker, motion).failure
    assert failure.kind is FailureKind.IN_COLLISION and "table" in failure.what
    planned = plan_free_motion(MODEL, checker, MODEL.q_park, q1)
    assert planned.failure is not None and planned.failure.values["end"] == "goal"


class Looked:
    """A checker that records its poses and reports a contact at the pose `meets`."""

    def __init__(self, meets=None):
        self.meets, self.path, self.fingers = meets, None, None

    def first_collision(self, path, *, allow_fingertips=False):
        self.path, self.fingers = path, allow_fingertips
        return None if self.meets is None else Contact("left hand", "right hand", self.meets)

    def first_contact_after_parting(self, path, *, allow_fingertips=False):
        return self.first_collision(path, allow_fingertips=allow_fingertips)


def there_and_back(distance, seconds):
    """All joints move there and back with minimum jerk. The last joint moves furthest."""
    t = np.linspace(0.0, seconds, round(100 * seconds) + 1)
    u = 1.0 - np.abs(2.0 * t / seconds - 1.0)
    q = np.outer(u**3 * (10 - 15 * u + 6 * u**2), np.linspace(0.1, 1.0, 14) * distance)
    return ArmTrajectory(t, q, np.gradient(q, t, axis=0), np.zeros_like(q))


@pytest.mark.parametrize(("distance", "seconds"), [(1.2, 3.0), (0.3, 4.0), (0.01, 1.0), (0.0, 0.5)])
def test_paths_are_checked_densely_enough_for_crossing_hands(distance, seconds):
    """Between two checked poses no joint moves by more than 0.02 rad plus one sample."""
    motion, looked = there_and_back(distance, seconds), Looked()
    assert contact_along(looked, motion) is None and looked.fingers is False
    np.testing.assert_array_equal(looked.path[0], motion.q[0])
    np.testing.assert_array_equal(looked.path[-1], motion.q[-1])
    sample = np.abs(np.diff(motion.q, axis=0)).max()
    gaps = np.abs(np.diff(looked.path, axis=0)).max(axis=1) if len(looked.path) > 1 else np.zeros(1)
    assert gaps.max() <= 0.02 + sample + 1e-12
    furthest = looked.path[:, -1].max()
    assert distance - furthest <= 0.02 + sample, "the turning point is checked too"


@pytest.mark.parametrize("met", [0, 7, 40])
def test_a_contact_is_reported_with_its_place_on_the_trajectory(met):
    motion, looked = there_and_back(1.2, 3.0), Looked(met)
    contact = contact_along(looked, motion, allow_fingertips=True)
    assert looked.fingers is True
    np.testing.assert_array_equal(motion.q[contact.index], looked.path[met])
    assert "left hand" in str(contact)
