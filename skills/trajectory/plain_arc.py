"""The tool paths of a fold's plain arc, for checks that need a path before anything is optimised."""

from __future__ import annotations

from skills.garments.garment import Garment
from skills.trajectory.bezier import two_parameter_controls
from skills.trajectory.frame import frames_of
from skills.trajectory.optimise import PLAIN_H
from skills.trajectory.paths import fold_duration, tool_paths
from skills.vocabulary import FoldStep, GraspId, GraspTrajectory, ToolPath

__all__ = ["plain_paths"]

MAX_HEIGHT = 0.40
"""Maximum height of an arc above the table [m], as in the optimiser."""


def plain_paths(step: FoldStep, garment: Garment) -> dict[GraspId, ToolPath]:
    """Compute the tool paths of the optimiser's plain arc (PLAIN_H, lower for a long fold), at the speed that the
    cloth allows."""
    frames = frames_of(step, garment.material.thickness)
    height = min(PLAIN_H, MAX_HEIGHT / (0.75 * max(f.distance for f in frames.values())))
    controls = {i: two_parameter_controls(f.start, f.end, height, 0.0) for i, f in frames.items()}
    duration = fold_duration(controls, garment.max_tool_speed)
    trajectory = GraspTrajectory(controls, duration, "plain", 0.0, 0.0)
    return tool_paths(trajectory, step, garment.max_tool_speed)
