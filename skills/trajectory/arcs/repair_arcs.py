"""Arcs that repair a fold: they carry cloth back where it lay before the fold, or on to the target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from foldcell.skills.fold_plan.repair import RepairGoal, RepairPlan
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.trajectory.arcs.frame import FoldFrame, frames_of
from foldcell.skills.vocabulary import Array, GraspId, ToolPath, frozen


def repair_arcs(
    controls: Mapping[GraspId, Array], plan: RepairPlan, thickness: float
) -> tuple[dict[GraspId, Array], ...]:
    """Return candidates for the control points (n + 1, 3) of a repair: first the arcs of the fold, scaled to begin
    where the cloth lies now, and reversed if the cloth is carried back; then plain initial arcs.

    controls: (n + 1, 3) of the fold's arcs [m]; thickness: of a layer [m]. The tips begin in the middle of the
    lowest grasped layer, so that they leave the layers below it.
    """
    like_the_fold, plain = {}, {}
    for grasp_id, frame in frames_of(plan.step, thickness).items():
        start = frozen(frame.start + np.array([0.0, 0.0, 0.5 * thickness]))
        arc = np.asarray(controls[grasp_id])[:: -1 if plan.goal is RepairGoal.UNDO else 1]
        scaled = FoldFrame(start, frame.end).denormalise(FoldFrame(arc[0], arc[-1]).normalise(arc))
        like_the_fold[grasp_id] = frozen(scaled)
        plain[grasp_id] = frozen(arc_controls(start, frame.end))
    return like_the_fold, plain


def turned_paths(
    paths: Mapping[GraspId, ToolPath], headings: Mapping[GraspId, tuple[float, float]]
) -> dict[GraspId, ToolPath]:
    """Return the paths with a tool that turns smoothly. headings: for each grasp, the heading at the grasp and at
    the release [rad]."""

    def turned(path: ToolPath, begin: float, end: float) -> ToolPath:
        step = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
        share = np.r_[0.0, np.cumsum(step)] / max(float(step.sum()), 1e-9)
        return replace(path, heading=frozen(begin + (end - begin) * share**2 * (3.0 - 2.0 * share)))

    return {grasp_id: turned(path, *headings[grasp_id]) for grasp_id, path in paths.items()}
