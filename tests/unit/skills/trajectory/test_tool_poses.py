"""Exported trajectories, read back by other programs' readers."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from foldcell.skills.trajectory.export import joint_trajectory, pose_rows, tool_poses_text
from foldcell.skills.vocabulary import ToolPath

T = np.linspace(0, 1, 5)
ANGLE = 0.3 * T
PATH = ToolPath(T, np.column_stack([T, 2 * T, 0 * T]), ANGLE, 0.5 * ANGLE, 0.2 * ANGLE)
FOLDS = {"half": {"left": pose_rows(PATH), "right": pose_rows(PATH)}, "sleeve": {"left": pose_rows(PATH)}}


def test_csv_has_a_row_for_each_pose() -> None:
    rows = list(csv.DictReader(tool_poses_text("g", FOLDS, ".csv").splitlines()))
    assert [(r["fold"], r["arm"]) for r in rows[::5]] == [("half", "left"), ("half", "right"), ("sleeve", "left")]
    assert [float(r["y_m"]) for r in rows[:5]] == pytest.approx(list(2 * T))
    read = Rotation.from_quat([[float(r[k]) for k in ("qx", "qy", "qz", "qw")] for r in rows[:5]])
    assert np.allclose(read.as_matrix(), PATH.rotation, atol=1e-5)


def test_json_has_the_same_poses() -> None:
    value = json.loads(tool_poses_text("g", FOLDS, ".json"))
    assert np.allclose(np.array(value["folds"]["half"]["left"]), FOLDS["half"]["left"], atol=1e-6)


def test_yaml_is_a_ros_message_for_each_fold() -> None:
    """The fields are those of trajectory_msgs/MultiDOFJointTrajectory."""
    half, sleeve = yaml.safe_load_all(tool_poses_text("g", FOLDS, ".yaml"))
    assert list(half) == ["header", "joint_names", "points"]
    assert (half["header"]["frame_id"], half["joint_names"]) == ("table", ["left", "right"])
    assert sleeve["joint_names"] == ["left"] and len(half["points"]) == len(T)
    last = half["points"][-1]
    assert set(last) == {"transforms", "velocities", "accelerations", "time_from_start"}
    assert last["transforms"][1]["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert np.isclose(sum(v**2 for v in last["transforms"][0]["rotation"].values()), 1.0, atol=1e-5)
    assert half["points"][1]["time_from_start"] == {"secs": 0, "nsecs": 250_000_000}


def test_joint_set_points_are_a_ros_message() -> None:
    """The fields are those of trajectory_msgs/JointTrajectory; times count from the first set-point."""
    q = np.arange(6.0).reshape(3, 2)
    message = joint_trajectory(("a", "b"), np.array([7.0, 7.01, 8.5]), q, 0.1 * q)
    assert yaml.safe_load(yaml.safe_dump(message)) == message
    assert message["joint_names"] == ["a", "b"]
    assert [p["positions"] for p in message["points"]] == q.tolist()
    assert set(message["points"][0]) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    assert [p["time_from_start"] for p in message["points"]] == [
        {"secs": 0, "nsecs": 0}, {"secs": 0, "nsecs": 10_000_000}, {"secs": 1, "nsecs": 500_000_000},
    ]  # fmt: skip
