"""The changes of a plan that the page offers, and the edit that a message of the page asks for."""

from __future__ import annotations

from typing import Any

import numpy as np

from foldcell.cell.operator.console.messages import PlanChange
from foldcell.cell.report.camera_pictures.picture_places import on_picture, on_table
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.run_context import RunContext
from foldcell.skills.vocabulary import CameraCalibration, GraspId

__all__ = ["offered_changes", "plan_edit"]

KEYPOINT, GRASP = "keypoint", "grasp"


def offered_changes(context: RunContext, calibration: CameraCalibration) -> dict[str, Any] | None:
    """Return the possible changes of the present fold's plan: the points that can be dragged, with their places as
    shares (0..1) of the picture's width and height, and the fold variants. None if the fold has no such plan."""
    plan, attempt = context.plan, context.fold.attempt
    if plan is None or attempt is None or attempt.carried or context.fold.repair is not None:
        return None
    named = [(GRASP, grasp_id.value, grasp.point) for grasp_id, grasp in attempt.step.grasps.items()]
    if context.fold.index == 0:
        named += [(KEYPOINT, name, point) for name, point in plan.flat.keypoints.items()]
    places = on_picture(np.array([point for *_, point in named]), calibration)
    return {
        "points": [
            {"kind": kind, "name": name, "at": [round(float(u), 4), round(float(v), 4)]}
            for (kind, name, _), (u, v) in zip(named, places, strict=True)
        ],
        "variants": [v.name for v in plan.garment.plan[context.fold.index].variants],
        "variant": attempt.step.variant,
    }


def plan_edit(change: PlanChange, calibration: CameraCalibration, by: str) -> PlanEdit | None:
    """Return the edit for a change that the page asks for. None if it is no change of a plan."""
    if change.variant is not None:
        return PlanEdit(by, variant=change.variant)
    if change.arc is not None:
        return PlanEdit(by, other_arc=True)
    point = None if change.to is None else on_table(change.to, calibration)
    if point is None:
        return None
    if change.grasp is not None:
        return PlanEdit(by, grasps={GraspId(change.grasp): point})
    return PlanEdit(by, keypoints={change.keypoint: point}) if change.keypoint is not None else None
