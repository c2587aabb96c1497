"""Arcs that carry cloth back where it lay before a fold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skills.trajectory.bezier import initial_controls
from skills.trajectory.frame import FoldFrame, frames_of
from skills.vocabulary import Array, FoldStep, GraspId, ToolPath, frozen

__all__ = ["return_arcs", "turned_paths"]


def return_arcs(
    controls: Mapping[GraspId, Array], step: FoldStep, thickness: float
) -> tuple[dict[GraspId, Array], ...]:
    """Return candidates for the control points (n + 1, 3) of the way back: the arcs of the fold, reversed and
    scaled to begin where the cloth lies now, and the plain initial arcs.

    controls: of the fold's arcs; step: the way back; thickness: of a layer [m]. The tips begin in the middle of
    the lowest grasped layer, so that they leave the layers below it.
    """
    reverse, plain = {}, {}
    for grasp_id, frame in frames_of(step, thickness).items():
        start = frozen(frame.start + np.array([0.0, 0.0, 0.5 * thickness]))
        here, back = FoldFrame(start, frame.end), np.asarray(controls[grasp_id])[::-1]
        reverse[grasp_id] = frozen(here.denormalise(FoldFrame(back[0], back[-1]).normalise(back)))
        plain[grasp_id] = frozen(initial_controls(start, frame.end))
    return reverse, plain


def turned_paths(
    paths: Mapping[GraspId, ToolPath], headings: Mapping[GraspId, tuple[float, float]]
) -> dict[GraspId, ToolPath]:
    """Return the paths with the tool turning smoothly between two headings, at the grasp and at the release
    [rad]."""

    def turned(path: ToolPath, begin: float, end: float) -> ToolPath:
        step = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
        share = np.r_[0.0, np.cumsum(step)] / max(float(step.sum()), 1e-9)
        return replace(path, heading=frozen(begin + (end - begin) * share**2 * (3.0 - 2.0 * share)))

    return {grasp_id: turned(path, *headings[grasp_id]) for grasp_id, path in paths.items()}
