"""Draws the expected garment and the hands' arcs over a live picture, while the arms move."""

from __future__ import annotations

from foldcell.cell.report.camera_pictures.projected_drawing import Picture, ProjectedDrawing
from foldcell.cell.report.camera_pictures.question_picture import ARCS, EXPECTED
from foldcell.cell.states.stages import Attempt
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.fold_figures.drawn_mesh import outline
from foldcell.skills.vocabulary import CameraCalibration

SCALE = 1.25
"""The camera's picture is enlarged by this factor. A larger one is sharper, but the browser then decodes more
pixels, several times a second."""


def draw_live(
    frame: CameraFrame, calibration: CameraCalibration, attempt: Attempt | None, progress: float | None
) -> Picture:
    """Draw what is expected at this moment over the picture. Returns (h, w, 3).

    attempt: the fold that is being made, or None; progress: the share of its arc that is done (0..1), or None when
    the hands do not carry the garment now.
    """
    drawing = ProjectedDrawing(frame, calibration, SCALE)
    if attempt is None or progress is None:
        return drawing.picture
    for contour in outline(_expected(attempt, progress), attempt.predicted.triangles):
        drawing.dashes(contour, EXPECTED, closed=True)
    entries = [("expected now", EXPECTED, True)]
    for side, posture in attempt.motion.postures.items():
        drawing.line(attempt.paths[posture.path].position, ARCS[side], 2)
        entries.append((f"{side.value} hand", ARCS[side], False))
    drawing.legend(entries)
    return drawing.picture


def _expected(attempt: Attempt, progress: float) -> Array:
    """Return the predicted vertices (n, 3) [m] of the moment nearest to this share of the arc."""
    frames = attempt.plan_frames
    return (
        frames[round(min(max(progress, 0.0), 1.0) * (len(frames) - 1))]
        if len(frames)
        else attempt.predicted.vertices
    )
