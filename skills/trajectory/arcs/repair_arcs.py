"""Arcs that repair a fold: they carry cloth back where it lay before the fold, or on to the target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skills.cloth.mesh import ClothMesh
from skills.cloth.pinch import PadGeometry, find_pinched
from skills.planning.repair import RepairGoal, RepairPlan, is_own
from skills.trajectory.arcs.bezier import initial_controls
from skills.trajectory.arcs.frame import FoldFrame, frames_of
from skills.vocabulary import Array, FoldStep, GraspId, ToolPath, frozen, tool_rotation

__all__ = ["repair_arcs", "start_heights", "turned_paths"]


HEIGHTS = 0.25
"""Spacing of the heights at which the tips may begin, in thicknesses of a layer."""


def repair_arcs(
    controls: Mapping[GraspId, Array],
    plan: RepairPlan,
    thickness: float,
    raised: Mapping[GraspId, float] | None = None,
) -> tuple[dict[GraspId, Array], ...]:
    """Return candidates for the control points (n + 1, 3) of a repair: the arcs of the fold, scaled to begin where
    the cloth lies now and reversed for the way back, and the plain initial arcs.

    controls: (n + 1, 3) of the fold's arcs [m]; thickness: of a layer [m]. raised: height of the tips above the
    layers that they leave, in thicknesses of a layer (`start_heights`); None: the middle of the lowest grasped
    layer.
    """
    like_the_fold, plain = {}, {}
    for grasp_id, frame in frames_of(plan.step, thickness).items():
        above = (raised or {}).get(grasp_id, 0.5) * thickness
        start = frozen(frame.start + np.array([0.0, 0.0, above]))
        arc = np.asarray(controls[grasp_id])[:: -1 if plan.goal is RepairGoal.UNDO else 1]
        scaled = FoldFrame(start, frame.end).denormalise(FoldFrame(arc[0], arc[-1]).normalise(arc))
        like_the_fold[grasp_id] = frozen(scaled)
        plain[grasp_id] = frozen(initial_controls(start, frame.end))
    return like_the_fold, plain


def start_heights(
    mesh: ClothMesh,
    before: Array,
    now: Array,
    step: FoldStep,
    plan: RepairPlan,
    thickness: float,
    pads: PadGeometry | None = None,
) -> dict[GraspId, float]:
    """Return the height of each hand's tips above the layers that it leaves, in thicknesses of a layer, at which a
    simulated hand takes cloth of its grasp, as little other cloth as possible, and then as much of its own.

    A hand presses lofty cloth together before it closes. The simulation does not, so that tips in the middle of
    the lowest grasped layer would take layers below it, too. before, now: (n, 3) believed vertices before the fold
    and now [m]; step: the fold that is repaired, at the same place.
    """
    heights = {}
    for grasp_id, frame in frames_of(plan.step, thickness).items():
        grasp, came_from = plan.step.grasps[grasp_id], step.grasps[grasp_id].point
        rotation = tool_rotation(np.array([grasp.heading]), np.zeros(1), np.zeros(1))[0]

        def taken(
            raised: float, start: Array = frame.start, turned: Array = rotation, origin: Array = came_from
        ) -> tuple[bool, int, int]:
            at = start + np.array([0.0, 0.0, raised * thickness])
            found = find_pinched(mesh, now, at, turned, pads or PadGeometry(), thickness)
            lay = np.einsum("kc,kci->ki", found.bary, before[found.vertex])[:, :2]
            own = is_own(lay, origin, at[:2])
            return bool(own.any()), -int((~own).sum()), int(own.sum())

        heights[grasp_id] = max(np.arange(0.5, grasp.layers, HEIGHTS).tolist(), key=taken)
    return heights


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
