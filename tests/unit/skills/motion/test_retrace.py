"""Motions along an earlier path: back, or on to its end."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.robots.baxter.robot import load_model
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, Side, arm_slice
from foldcell.skills.motion.kinematics.ik import tool_pose
from foldcell.skills.motion.moves.lift import plan_lift
from foldcell.skills.motion.moves.retrace import FARTHEST, nearest_on, plan_along, share_done, without_loops
from foldcell.skills.motion.timing.timing import free_motion, peaks
from foldcell.skills.motion.validation.collision import CollisionChecker
from foldcell.skills.motion.validation.trajectory_check import check_trajectory
from foldcell.skills.vocabulary import Table

MODEL = load_model()
TABLE = Table(-0.10, (0.20, 1.10), (-0.75, 0.75))
PARK = MODEL.q_park


@pytest.fixture(scope="module")
def checker() -> CollisionChecker:
    return CollisionChecker(MODEL, TABLE)


def outward() -> Array:
    """A path (n, 14) from the parked posture outwards, then up."""
    there = PARK + np.r_[0.3, -0.2, np.zeros(5), -0.3, -0.2, np.zeros(5)]
    up = there + np.r_[0.0, -0.15, np.zeros(5), 0.0, -0.15, np.zeros(5)]
    parts = [free_motion(PARK, there, MODEL.planning), free_motion(there, up, MODEL.planning)]
    return np.vstack([part.q for part in parts])


def distance_to(path: Array, q: Array) -> Array:
    """Distance (m,) of each configuration of q (m, 14) from the densely sampled path (n, 14) [rad]."""
    return np.array([np.abs(path - row).max(axis=1).min() for row in q])


@pytest.mark.parametrize("share", [0.2, 0.6, 1.0])
@pytest.mark.parametrize("backwards", [True, False])
def test_the_motion_follows_the_path_to_its_end(checker: CollisionChecker, share: float, backwards: bool) -> None:
    path = outward()[::-1] if backwards else outward()
    k = round(share * (len(path) - 1)) if share < 1.0 else len(path) - 1
    planned = plan_along(MODEL, checker, path[k], path)
    assert planned.ok, planned.failure
    motion = planned.unwrap()
    assert motion.q[0] == pytest.approx(path[k]) and motion.q[-1] == pytest.approx(path[-1])
    assert distance_to(path, motion.q).max() < 0.005
    assert check_trajectory(MODEL, checker, motion, path[k], MODEL.planning, allow_fingertips=True).ok


def test_the_distance_from_the_path_fades_out(checker: CollisionChecker) -> None:
    """An arm that was held beside its path joins it again."""
    path = outward()[::-1]
    beside = path[20] + np.r_[np.zeros(4), 0.08, np.zeros(9)]
    motion = plan_along(MODEL, checker, beside, path).unwrap()
    off = distance_to(path, motion.q)
    assert motion.q[0] == pytest.approx(beside) and motion.q[-1] == pytest.approx(path[-1])
    assert off.max() < 0.085 and off[-1] < 1e-6
    assert peaks(motion, MODEL.planning).worst <= 1.0


def test_near_the_end_of_the_path_its_end_is_reached_all_the_same(checker: CollisionChecker) -> None:
    path = outward()[::-1]
    beside = path[-1] + np.r_[np.zeros(4), 0.05, np.zeros(9)]
    motion = plan_along(MODEL, checker, beside, path).unwrap()
    assert motion.q[0] == pytest.approx(beside) and motion.q[-1] == pytest.approx(path[-1])


def test_tools_that_carry_cloth_keep_their_speed_limit(checker: CollisionChecker) -> None:
    path = outward()
    for speed in (0.05, 0.2):
        motion = plan_along(MODEL, checker, path[0], path, tool_speed=speed).unwrap()
        for side in Side:
            tool = np.array([tool_pose(MODEL.chains[side], q)[:3, 3] for q in motion.q[:, arm_slice(side, 14)]])
            fastest = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(motion.t)
            assert fastest.max() < 1.1 * speed


def test_arms_far_from_the_path_are_not_led_to_it(checker: CollisionChecker) -> None:
    off = np.r_[np.zeros(4), FARTHEST + 0.05, np.zeros(9)]
    planned = plan_along(MODEL, checker, PARK + off, outward())
    assert planned.failure is not None and planned.failure.kind is FailureKind.UNREACHABLE
    assert "degrees from the path" in planned.failure.what and planned.failure.hint


def test_hands_that_are_too_near_are_led_apart_onto_the_path(checker: CollisionChecker) -> None:
    """A fault has turned both arms inwards, until the hands nearly touch; the path itself is free."""
    inwards = np.r_[-0.01, np.zeros(6), 0.01, np.zeros(6)]
    path = outward()[::-1]
    while checker.first_collision(path[::10] + 10 * inwards) is None:
        path = path + inwards
    near = path[len(path) // 2]
    while not checker.in_collision(near):
        near = near + inwards
    planned = plan_along(MODEL, checker, near, path)
    assert planned.ok, planned.failure
    motion = planned.unwrap()
    assert motion.q[0] == pytest.approx(near) and motion.q[-1] == pytest.approx(path[-1])
    assert check_trajectory(MODEL, checker, motion, near, MODEL.planning, allow_fingertips=True).ok


def test_a_path_that_is_no_longer_free_is_refused(checker: CollisionChecker) -> None:
    """Its end is in the table, with the hands and not only their fingers."""
    down = np.array(PARK)
    down[[0, 7]] += [-0.5, 0.5]
    down[[1, 8]] += 1.0
    planned = plan_along(MODEL, checker, PARK, free_motion(PARK, down, MODEL.planning).q)
    assert planned.failure is not None and planned.failure.kind is FailureKind.IN_COLLISION


def test_a_state_that_is_not_known_is_refused(checker: CollisionChecker) -> None:
    planned = plan_along(MODEL, checker, np.full(14, np.nan), outward())
    assert planned.failure is not None and planned.failure.kind is FailureKind.STALE_STATE


def test_loops_are_left_out(checker: CollisionChecker) -> None:
    """Down to a grasp and up again leads back to the same place, so the way back does not go down."""
    path = outward()
    up = plan_lift(MODEL, checker, path[-1], tuple(Side), 0.05).unwrap().q
    with_loop = np.vstack([path, up, up[::-1], path[::-1][:10]])
    short = without_loops(with_loop)
    assert len(short) < len(path) and short[0] == pytest.approx(path[0])
    assert short[-1] == pytest.approx(with_loop[-1])
    assert np.abs(np.diff(short, axis=0)).max() < 0.1, "it is still one path"
    assert distance_to(path, short).max() < 1e-9, "and it does not enter the loop"


def test_the_share_of_the_path_grows_along_it() -> None:
    path = outward()
    shares = [share_done(path, q) for q in path[::10]]
    assert shares[0] == 0.0 and share_done(path, path[-1]) == 1.0 and np.all(np.diff(shares) >= 0.0)
    assert nearest_on(path, path[17]) == 17
    assert share_done(path[:1], path[0]) == 0.0
