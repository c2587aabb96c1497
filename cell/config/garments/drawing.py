"""Draw a garment file: outline, key points, and each fold with its line and grasps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.folding import silhouette
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import FoldStep

SCALE = 400.0
"""Pixels per metre."""
MARGIN = 60
_INK, _CLOTH, _LINE, _GRASP, _TARGET = (40, 44, 52), (214, 226, 240), (208, 52, 44), (36, 140, 60), (44, 90, 208)


def draw_garment(garment: Garment) -> NDArray[np.uint8]:
    """Return an (H, W, 3) RGB picture with one panel per fold, from left to right. Each panel is a top view with
    the robot at the bottom."""
    x, y, angle = garment.poses.middle
    state = garment.flat_state(x, y, angle)
    steps = plan_folds(state, garment).unwrap()
    outline = np.asarray(state.contour)
    panels = [_panel(garment, outline, step, (x, y)) for step in steps]
    return np.ascontiguousarray(np.hstack(panels))


def _panel(garment: Garment, outline: Array, step: FoldStep, centre: tuple[float, float]) -> NDArray[np.uint8]:
    half = 0.5 * float(np.linalg.norm(garment.size_m)) + 0.02
    size = int(2 * half * SCALE) + 2 * MARGIN
    picture = np.full((size, size, 3), 255, np.uint8)

    def pixel(p: Array) -> tuple[int, int]:
        dx, dy = np.asarray(p)[:2] - centre  # in the picture table x points up and table y to the left
        return int(size / 2 - dy * SCALE), int(size / 2 - dx * SCALE)

    before = np.array([pixel(p) for p in silhouette(step.earlier, outline)], np.int32)
    cv2.fillPoly(picture, [before], _CLOTH)
    cv2.polylines(picture, [before], True, _INK, 2, cv2.LINE_AA)
    direction = step.line.direction
    middle = step.line.point + direction * float(direction @ (np.asarray(centre) - step.line.point))
    cv2.line(picture, pixel(middle - half * direction), pixel(middle + half * direction), _LINE, 2, cv2.LINE_AA)
    for grasp_id, grasp in step.grasps.items():
        along = 0.03 * np.array([np.cos(grasp.heading), np.sin(grasp.heading)])
        cv2.line(picture, pixel(grasp.point - along), pixel(grasp.point + along), _GRASP, 5, cv2.LINE_AA)
        target = pixel(step.targets[grasp_id])
        cv2.arrowedLine(picture, pixel(grasp.point), target, _TARGET, 2, cv2.LINE_AA, 0, 0.06)
        column, row = pixel(grasp.point)
        _text(picture, f"{grasp_id.planned_arm} arm", (column + 4, row + 30))
    if not step.earlier:
        for name, point in zip(garment.keypoints, outline, strict=True):
            cv2.circle(picture, pixel(point), 5, _INK, -1, cv2.LINE_AA)
            _text(picture, name, pixel(point))
    _text(picture, f"{garment.name}  {step.index + 1} {step.name}", (4, 18))
    return picture


def _text(picture: NDArray[np.uint8], text: str, place: tuple[int, int]) -> None:
    width = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)[0][0]
    x = min(max(4, place[0] + 8), picture.shape[1] - width - 4)
    cv2.putText(picture, text, (x, max(14, place[1] - 8)), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _INK, 1, cv2.LINE_AA)
