"""The look of a run's garment in drawn pictures: its own colours and its original outline, as the camera saw
them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.report.camera_pictures.projected_drawing import Colour, Picture, ProjectedDrawing
from foldcell.cell.report.pictures.fold_pictures import AMBIENT, CLOTH, LIGHT, TAPE, ClothColours
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.vocabulary import CameraCalibration

EDGE = 9
"""Pixels nearer to the garment's edge than half of this are not sampled: the edge mixes two colours [px]."""
UNDERSIDE = 0.35
"""The underside is drawn in the same colour, mixed with this share of white, or of black for a light garment. The
camera sees both sides alike, and the picture has to tell them apart."""
LIGHT_CLOTH = 170.0
"""Garments whose mean channel is above this are light."""
DARKEST = 48.0
"""Folds of a black garment would not show: its lightest channel is raised to this."""


def garment_look(context: RunContext) -> tuple[ClothColours, Array | None]:
    """Return the colours of both sides of the garment that the run has recognised, and the outline (n, 2) of the
    flat garment, as it was laid, in the table frame [m]; None if it was not seen."""
    if context.recognition is None:
        return CLOTH, None
    seen, first = context.recognition.perception, context.first_look
    outline = seen.state.contour if first is None or len(first.contour) < 3 else first.contour
    return seen_colours(seen.rgb, seen.mask), np.asarray(outline)


def outlined(frame: CameraFrame, calibration: CameraCalibration | None, outline: Array | None) -> Picture:
    """Return the camera's picture (H, W, 3) with the outline (n, 2) [m] on it, if both are known. It may be
    enlarged."""
    if calibration is None or outline is None:
        return np.asarray(frame.rgb, dtype=np.uint8)
    drawing = ProjectedDrawing(frame, calibration)
    drawing.line(outline, TAPE, closed=True)
    return drawing.picture


def seen_colours(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> ClothColours:
    """Return the colours of the cloth in a picture (H, W, 3): the median inside the mask (H, W). Drawn cloth that
    lies flat then has the colour of the picture."""
    inside = cv2.erode(mask.astype(np.uint8), np.ones((EDGE, EDGE), np.uint8)) > 0
    if not inside.any():
        inside = mask
    if not inside.any():
        return CLOTH
    seen = np.median(rgb[inside], axis=0)
    flat = AMBIENT + (1.0 - AMBIENT) * float(LIGHT[2])  # the brightness of cloth that faces upwards
    front = np.clip(seen / flat, 0.0, 255.0)
    front += max(0.0, DARKEST - float(front.max()))
    other = 0.0 if front.mean() > LIGHT_CLOTH else 255.0
    return ClothColours(_colour(front), _colour((1.0 - UNDERSIDE) * front + UNDERSIDE * other))


def _colour(rgb: Array) -> Colour:
    red, green, blue = (int(c) for c in np.round(rgb))
    return red, green, blue
