"""The changes of a plan that the page offers, and the edit that a message of the page asks for."""

from __future__ import annotations

from typing import Any

import numpy as np

from foldcell.cell.operator.console.messages import PlanChange
from foldcell.cell.states.plan_edit import PlanEdit
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.ports import Array
from foldcell.skills.vocabulary import CameraCalibration, GraspId

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


def on_picture(points: Array, calibration: CameraCalibration) -> Array:
    """Return the places (n, 2) of points (n, 2) on the table [m], as shares (0..1) of the picture's width and
    height."""
    k, T = calibration.intrinsics, np.linalg.inv(calibration.T_table_camera)
    seen = np.column_stack([points, np.zeros(len(points))]) @ T[:3, :3].T + T[:3, 3]
    pixels = np.array([k.fx, k.fy]) * seen[:, :2] / seen[:, 2:] + np.array([k.cx, k.cy])
    return np.asarray((pixels + 0.5) / np.array([k.width, k.height]))


def on_table(place: tuple[float, float], calibration: CameraCalibration) -> tuple[float, float] | None:
    """Return the point (x, y) of the table [m] at a place of the picture: the inverse of `on_picture`. None if the
    ray does not meet the table."""
    k, T = calibration.intrinsics, calibration.T_table_camera
    u, v = place[0] * k.width - 0.5, place[1] * k.height - 0.5
    ray = T[:3, :3] @ np.array([(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0])
    if ray[2] >= 0.0:
        return None
    point = T[:3, 3] - T[2, 3] / ray[2] * ray
    return float(point[0]), float(point[1])
