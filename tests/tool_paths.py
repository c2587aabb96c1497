"""Deviation of tools from their planned paths, measured without the planner's kinematics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.robots.model import RobotModel
from foldcell.robots.ports import ArmTrajectory, Array, Side
from foldcell.skills.vocabulary import Table, ToolPath


def path_deviation(
    model: RobotModel, table: Table, trajectory: ArmTrajectory, intended: Mapping[Side, ToolPath]
) -> float:
    """Largest distance of a tool from its planned path [m], regardless of time."""
    worst = 0.0
    for side, path in intended.items():
        p = np.array([model.tool_pose(side, q)[:3, 3] for q in trajectory.q[::3]])
        p[:, 2] -= table.height
        worst = max(worst, float(_distance_to_line(p, path.position).max()))
    return worst


def _distance_to_line(points: Array, line: Array) -> Array:
    """Distances (n,) of points (n, 3) from the polyline (m, 3)."""
    a, d = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum((d**2).sum(axis=1), 1e-18)
    gap = points[:, None, :] - a
    u = np.clip((gap * d).sum(axis=2) / length2, 0.0, 1.0)
    distances: Array = np.linalg.norm(gap - u[..., None] * d, axis=2).min(axis=1)
    return distances
