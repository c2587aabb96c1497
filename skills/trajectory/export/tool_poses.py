"""The tool poses of folds over time as CSV, JSON or ROS messages, for a robot of any build."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from foldcell.skills.trajectory.export.ros_messages import pose_trajectory
from foldcell.skills.vocabulary import Array, ToolPath, frozen

__all__ = ["COLUMNS", "MARKS", "pose_rows", "tool_poses_text"]

COLUMNS = ("t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
FRAME = "table"
MARKS = {
    ".csv": b"fold,arm,t_s,x_m",
    ".json": b'"frame": "table", "columns": ["t_s"',
    ".yaml": b"trajectory_msgs/MultiDOFJointTrajectory",
}
"""Suffix of each format -> text that every file of it contains."""


def pose_rows(path: ToolPath) -> Array:
    """Return rows (n, 8) of a path: time [s], position of the tool centre point [m] and orientation of the tool
    frame (quaternion, scalar last), both in the table frame (robots/ports.py)."""
    return frozen(np.column_stack([path.t, path.position, Rotation.from_matrix(path.rotation).as_quat()]))


def tool_poses_text(garment: str, folds: Mapping[str, Mapping[str, Array]], suffix: str) -> str:
    """Return the poses as text. folds: fold -> arm -> `pose_rows`, from the grasp through the straight lift to the
    release. suffix: one of MARKS; '.yaml' is one trajectory_msgs/MultiDOFJointTrajectory for each fold, as
    documents of one YAML file.
    """
    rounded = {
        fold: {arm: [[round(float(v), 6) for v in row] for row in rows] for arm, rows in arms.items()}
        for fold, arms in folds.items()
    }
    if suffix == ".csv":
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("fold", "arm", *COLUMNS))
        writer.writerows(
            (fold, arm, *row) for fold, arms in rounded.items() for arm, rows in arms.items() for row in rows
        )
        return text.getvalue()
    if suffix == ".json":
        value = {"schema": 1, "garment": garment, "frame": FRAME, "columns": COLUMNS, "folds": rounded}
        return json.dumps(value) + "\n"
    return "".join(
        f"---\n# {garment}, fold {fold}: trajectory_msgs/MultiDOFJointTrajectory\n"
        + yaml.safe_dump(_message(arms), sort_keys=False, default_flow_style=None, width=200)
        for fold, arms in folds.items()
    )


def _message(arms: Mapping[str, Array]) -> dict[str, object]:
    tools = {arm: (rows[:, 0], rows[:, 1:4], rows[:, 4:]) for arm, rows in arms.items()}
    return pose_trajectory(FRAME, tools)
