"""Exports trajectories for a robot of any build: the tool poses of folds over time as CSV, JSON or ROS messages.

A ROS message is a mapping that YAML and JSON can hold. `rostopic pub` takes it as YAML, and
`rospy_message_converter` turns it into a message.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from foldcell.skills.vocabulary import Array, ToolPath, frozen

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


def joint_trajectory(names: Sequence[str], t: Array, q: Array, qd: Array) -> dict[str, Any]:
    """Return a trajectory_msgs/JointTrajectory. t: (n,) [s], of which the first is the start; q, qd: (n, joints)
    [rad], [rad/s]. The message has no accelerations and no efforts."""
    points = [
        {
            "positions": [round(float(v), 6) for v in position],
            "velocities": [round(float(v), 6) for v in velocity],
            "accelerations": [],
            "effort": [],
            "time_from_start": _duration(float(at - t[0])),
        }
        for at, position, velocity in zip(t, q, qd, strict=True)
    ]
    return {"header": _header(""), "joint_names": list(names), "points": points}


def pose_trajectory(frame: str, tools: Mapping[str, tuple[Array, Array, Array]]) -> dict[str, Any]:
    """Return a trajectory_msgs/MultiDOFJointTrajectory: the poses of tools over time, for a robot of any build.

    frame: name of the frame of the poses. tools: name -> (t (n,) [s], position (n, 3) [m], quaternion (n, 4),
    scalar last). All tools have the same times.
    """
    times = next(iter(tools.values()))[0]
    points = [
        {
            "transforms": [_transform(position[k], quaternion[k]) for _, position, quaternion in tools.values()],
            "velocities": [],
            "accelerations": [],
            "time_from_start": _duration(float(at - times[0])),
        }
        for k, at in enumerate(times)
    ]
    return {"header": _header(frame), "joint_names": list(tools), "points": points}


def _header(frame: str) -> dict[str, Any]:
    return {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": frame}


def _duration(seconds: float) -> dict[str, int]:
    whole, rest = divmod(round(seconds * 1e9), 1_000_000_000)
    return {"secs": int(whole), "nsecs": int(rest)}


def _transform(position: Array, quaternion: Array) -> dict[str, Any]:
    return {
        "translation": dict(zip("xyz", (round(float(v), 6) for v in position), strict=True)),
        "rotation": dict(zip("xyzw", (round(float(v), 6) for v in quaternion), strict=True)),
    }
