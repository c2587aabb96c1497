"""The coordinate frame of a fold: origin at the grasp, first axis horizontal towards the target, third axis up,
the fold's distance as unit.

In this frame the arcs of a small and a large towel have the same coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.skills.vocabulary import Array, FoldStep, GraspId


@dataclass(frozen=True, eq=False)
class FoldFrame:
    """Frame of one grasp's arc. start, end: (3,) ends of the arc, table frame [m]. Axes: horizontal forward,
    horizontal left, up."""

    start: Array
    end: Array

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    @property
    def axes(self) -> Array:
        """(3, 3) the axes in the table frame, one unit vector in each row."""
        forward = (self.end - self.start) * (1.0, 1.0, 0.0)
        forward = forward / np.linalg.norm(forward)
        up = np.array([0.0, 0.0, 1.0])
        return np.stack([forward, np.cross(up, forward), up])

    def normalise(self, control: Array) -> Array:
        """Convert control points (n + 1, 3) to inner points (n - 1, 3) in this frame, dimensionless."""
        return (control[1:-1] - self.start) @ self.axes.T / self.distance

    def denormalise(self, inner: Array) -> Array:
        """Convert inner points (n - 1, 3) back to control points (n + 1, 3) from start to end."""
        points = self.start + self.distance * np.asarray(inner) @ self.axes
        return np.vstack([self.start, points, self.end])


def grasp_ends(step: FoldStep, grasp_id: GraspId, thickness: float) -> tuple[Array, Array]:
    """Return start (3,) and end (3,) of a grasp's arc [m]: the position of the fingertips under the lowest grasped
    layer, and the release point."""
    grasp = step.grasps[grasp_id]
    below = grasp.height - grasp.layers * thickness
    return np.append(grasp.point, max(0.0, below)), np.asarray(step.targets[grasp_id])


def frames_of(step: FoldStep, thickness: float) -> dict[GraspId, FoldFrame]:
    """Return the frame of every grasp of a step. thickness: of one layer [m]."""
    return {grasp_id: FoldFrame(*grasp_ends(step, grasp_id, thickness)) for grasp_id in step.grasps}
