"""Compiled kinematics against Pinocchio; inverse kinematics against its own forward map."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.motion.peers import jacobian
from foldcell.robots.baxter.robot import load_model
from foldcell.robots.ports import Side, arm_slice
from foldcell.skills.motion.kinematics import ik


@pytest.fixture(scope="module")
def model():
    return load_model()


def _random(model, rng, side):
    cut = arm_slice(side, 14)
    return rng.uniform(model.planning.lower[cut], model.planning.upper[cut])


def test_a_near_start_gives_a_near_solution(model):
    rng, regular = np.random.default_rng(3), 0
    for _ in range(50):
        q = 0.9 * _random(model, rng, Side.LEFT)
        q = np.clip(q, model.planning.lower[:7], model.planning.upper[:7])
        T = ik.tool_pose(model.chains[Side.LEFT], q)
        T[:3, 3] += rng.normal(0, 1e-4, 3)
        found = ik.solve_pose(model, Side.LEFT, T, q, gain=0.0)
        if np.linalg.svd(jacobian(model.chains[Side.LEFT], q))[1][-1] > 0.05:
            regular += 1
            assert found is not None and np.abs(found - q).max() < 0.02
    assert regular > 25


def test_a_pose_out_of_reach_has_no_solution(model):
    T = np.eye(4)
    T[:3, 3] = [2.5, 0.0, 0.0]
    assert ik.solve_pose(model, Side.LEFT, T, np.zeros(7)) is None
    assert len(ik.solve_seeds(model, Side.LEFT, T, np.zeros((3, 7)))) == 0


def _line(model, length):
    """A straight path in front of the left arm, with the hand pointing down."""
    q0 = np.array([-0.3, -0.3, 0.0, 1.2, 0.0, 0.7, 0.0])
    T = ik.tool_pose(model.chains[Side.LEFT], q0)
    position = T[:3, 3] + np.linspace(0, length, 80)[:, None] * np.array([0.2, -1.0, 0.1]) / np.linalg.norm(
        [0.2, 1, 0.1]
    )
    return np.tile(T[:3, :3], (80, 1, 1)), position, q0


def test_a_path_is_followed_everywhere_without_jumps(model):
    rotation, position, q0 = _line(model, 0.4)
    way = ik.follow_path(model, Side.LEFT, rotation, position, q0)
    assert way.shape == (80, 7)
    for q, R, p in zip(way, rotation, position, strict=True):
        T = ik.tool_pose(model.chains[Side.LEFT], q)
        assert np.abs(T[:3, 3] - p).max() < 1e-8 and np.abs(T[:3, :3] - R).max() < 1e-8
    assert np.abs(np.diff(way, axis=0)).max() < 0.05
    # The joint path is smooth enough for timing with a jerk limit: third differences have no solver noise.
    assert np.abs(np.diff(way[1:], n=3, axis=0)).max() < 1e-3


def test_following_a_path_ends_where_the_path_leaves_the_workspace(model):
    rotation, position, q0 = _line(model, 3.0)
    way = ik.follow_path(model, Side.LEFT, rotation, position, q0)
    assert len(way) < len(position)
    assert 5 < len(way) < 60
