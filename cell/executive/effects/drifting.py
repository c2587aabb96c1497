"""A garment that lies elsewhere than it was predicted takes the belief of it along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.states.context import Context
from robots.ports import Array, frozen
from skills.perception.inspection.inspect import Inspection
from skills.planning.plan import rigid_motion, translate_plan

__all__ = ["moved_along"]


def moved_along(context: Context, seen: Inspection | None) -> Context:
    """The plan that is left, the believed shape and its material coordinates, moved along with the garment."""
    if seen is None or context.mesh is None or context.vertices is None:
        return context

    def move(xy: Array) -> Array:
        return frozen(rigid_motion(xy, seen.drift, seen.drift_rad, seen.drift_about))

    flat = context.flat
    if flat is not None:
        keypoints = {name: move(p) for name, p in flat.keypoints.items()}
        flat = replace(flat, contour=move(flat.contour), keypoints=keypoints)
    vertices = frozen(np.column_stack([move(context.vertices[:, :2]), context.vertices[:, 2]]))
    return replace(
        context,
        flat=flat,
        steps=translate_plan(context.steps, seen.drift, seen.drift_rad, seen.drift_about),
        mesh=replace(context.mesh, rest=move(context.mesh.rest)),
        vertices=vertices,
    )
