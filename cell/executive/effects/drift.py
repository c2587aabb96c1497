"""Moves the plan to the observed place of a garment that lies elsewhere than predicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.states.stages import Plan
from robots.ports import Array, frozen
from skills.fold_plan.plan import rigid_motion, translate_plan
from skills.perception.inspection.inspect import Inspection

__all__ = ["apply_drift", "moved_contour"]


def apply_drift(plan: Plan, inspection: Inspection) -> Plan:
    """Return the plan after a drift: its flat garment, fold steps, believed shape and material coordinates are
    moved by the observed drift."""

    def move(xy: Array) -> Array:
        return moved_contour(xy, inspection)

    keypoints = {name: move(p) for name, p in plan.flat.keypoints.items()}
    return replace(
        plan,
        flat=replace(plan.flat, contour=move(plan.flat.contour), keypoints=keypoints),
        steps=translate_plan(plan.steps, inspection.drift, inspection.drift_rad, inspection.drift_about),
        mesh=replace(plan.mesh, rest=move(plan.mesh.rest)),
        vertices=frozen(np.column_stack([move(plan.vertices[:, :2]), plan.vertices[:, 2]])),
    )


def moved_contour(contour: Array, inspection: Inspection) -> Array:
    """Return points (n, 2) [m], moved by the observed drift."""
    return frozen(rigid_motion(contour, inspection.drift, inspection.drift_rad, inspection.drift_about))
