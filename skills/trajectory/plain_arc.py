"""A fold's plain arc and its tool paths, for checks that need a path before anything is optimised."""

from __future__ import annotations

from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.arcs.paths import fold_duration, tool_paths
from foldcell.skills.trajectory.search.optimise import PLAIN_H, arcs_of
from foldcell.skills.vocabulary import FoldStep, GraspId, GraspTrajectory, ToolPath

__all__ = ["plain_paths", "plain_trajectory"]


def plain_trajectory(step: FoldStep, garment: Garment, max_speed: float) -> GraspTrajectory:
    """Compute the optimiser's plain arc (PLAIN_H, lower for a long fold) of each grasp. max_speed: of the tools
    [m/s]. The dissimilarity of the trajectory is not known."""
    controls = arcs_of(frames_of(step, garment.material.thickness), PLAIN_H)
    return GraspTrajectory(controls, fold_duration(controls, max_speed), "plain", 0.0, 0.0)


def plain_paths(step: FoldStep, garment: Garment) -> dict[GraspId, ToolPath]:
    """Compute the tool paths of the plain arc at the speed that the cloth allows."""
    speed = garment.max_tool_speed
    return tool_paths(plain_trajectory(step, garment, speed), step, speed)
