"""Draw the predicted shape after each fold: on the table in perspective, and from above beside the plan."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.planning.plan_prediction import PredictedFold
from foldcell.cell.report.pictures.fold_pictures import KeyFrame, Scenery, draw_frame, join, motion_view
from foldcell.robots.ports import Array
from foldcell.skills.fold_figures.drawn_mesh import outline
from foldcell.skills.vocabulary import Table

Picture = NDArray[np.uint8]

SIZE = 460, 360
"""Width and height of one panel [px]."""
PAD, HEAD, FOOT = 24, 30, 30
_INK, _CLOTH = (40, 44, 52), (214, 226, 240)
_GOOD, _BAD, _PLANNED = (36, 140, 60), (208, 52, 44), (40, 160, 80)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_predictions(name: str, folds: Sequence[PredictedFold], table: Table) -> Picture:
    """Return an (H, W, 3) RGB picture with a column per fold: above, the predicted garment on the table; below,
    its outline from above (filled) and the planned one (green), with the robot at the bottom. All folds have the
    same scale."""
    frames = [KeyFrame(fold.shape.vertices) for fold in folds]
    view = motion_view(frames, size=SIZE)
    shaded = [
        draw_frame(frame, fold.shape.triangles, view, Scenery(table, tape=fold.outline))
        for frame, fold in zip(frames, folds, strict=True)
    ]
    outlines = [(outline(fold.shape.vertices, fold.shape.triangles), fold.outline) for fold in folds]
    everything = np.vstack([points for predicted, planned in outlines for points in (*predicted, planned)])
    flat = [_from_above(*shapes, everything) for shapes in outlines]
    captioned = [_captioned(name, *pair) for pair in zip(folds, shaded, strict=True)]
    rows = [join(captioned), join(flat)]
    picture = np.vstack([rows[0], np.full((6, rows[0].shape[1], 3), 255, np.uint8), rows[1]])
    return np.ascontiguousarray(np.vstack([picture, _legend(picture.shape[1])]))


def _captioned(name: str, fold: PredictedFold, picture: Picture) -> Picture:
    """Write the fold's name and figures over its picture."""
    head = np.full((2 * HEAD, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(head, f"{name}  {fold.step.index + 1} {fold.step.name}", (6, 20), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
    text, colour = _figures(fold)
    size = min(0.45, 0.45 * (head.shape[1] - 12) / max(cv2.getTextSize(text, _FONT, 0.45, 1)[0][0], 1))
    cv2.putText(head, text, (6, 46), _FONT, size, colour, 1, cv2.LINE_AA)
    return np.vstack([head, picture])


def _figures(fold: PredictedFold) -> tuple[str, tuple[int, int, int]]:
    if fold.reasons:
        return fold.reasons[0].what, _BAD
    assert fold.score is not None
    return f"good: {1e3 * fold.dissimilarity_m:.1f} mm off on average, overlap {fold.score.iou:.2f}", _GOOD


def _from_above(predicted: Sequence[Array], planned: Array, everything: Array) -> Picture:
    """Draw outlines (k, 2) [m] from above, at a scale at which all points of `everything` (n, 2) are shown."""
    width, height = SIZE
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = min((width - 2 * PAD) / (high[1] - low[1]), (height - 2 * PAD) / (high[0] - low[0]))
    middle = 0.5 * (low + high)
    picture = np.full((height, width, 3), 255, np.uint8)

    def pixel(xy: Array) -> NDArray[np.int32]:  # table x points up, table y to the left
        off = (np.asarray(xy, dtype=float) - middle) * scale
        return np.round(16.0 * np.stack([width / 2 - off[:, 1], height / 2 - off[:, 0]], -1)).astype(np.int32)

    for contour in predicted:
        cv2.fillPoly(picture, [pixel(contour)], _CLOTH, cv2.LINE_AA, 4)
        cv2.polylines(picture, [pixel(contour)], True, _INK, 1, cv2.LINE_AA, 4)
    cv2.polylines(picture, [pixel(planned)], True, _PLANNED, 2, cv2.LINE_AA, 4)
    bar = round(0.1 * scale)
    cv2.line(picture, (PAD, height - 10), (PAD + bar, height - 10), _INK, 2)
    cv2.putText(picture, "100 mm", (PAD + bar + 6, height - 6), _FONT, 0.4, _INK, 1, cv2.LINE_AA)
    return picture


def _legend(width: int) -> Picture:
    strip = np.full((FOOT, width, 3), 255, np.uint8)
    x = PAD
    for text, colour in (("simulated", _CLOTH), ("as planned", _PLANNED)):
        cv2.rectangle(strip, (x, 8), (x + 14, 20), colour, -1)
        cv2.rectangle(strip, (x, 8), (x + 14, 20), _INK, 1)
        cv2.putText(strip, text, (x + 20, 19), _FONT, 0.42, _INK, 1, cv2.LINE_AA)
        x += 130
    return strip
