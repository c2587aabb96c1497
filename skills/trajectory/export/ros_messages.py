"""Trajectories in the layout of ROS messages (trajectory_msgs), as mappings that YAML and JSON can hold.

`rostopic pub` takes such a mapping as YAML, and `rospy_message_converter` turns it into a message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from foldcell.robots.ports import Array

__all__ = ["joint_trajectory", "pose_trajectory"]


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
