"""Compares what a screenshot of the operator's page shows with the data of the plan that the cell asks about."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.report.camera_pictures.projected_drawing import ProjectedDrawing
from foldcell.cell.report.camera_pictures.question_picture import ARCS, EXPECTED, OUTLINE, present_outline
from foldcell.cell.states.run_context import RunContext
from foldcell.robots.ports import Array
from foldcell.skills.fold_figures.outline import outline
from foldcell.skills.vocabulary import CameraCalibration

__all__ = ["drawn_shares", "picture_of"]

TOLERANCE = 70.0
"""A pixel has a line's colour if it differs by at most this (of 441)."""
CLEAR = 12.0
"""Points of a line that are nearer to another line are not compared [px of the screen]."""
FEWEST = 10
"""A line with fewer free points is not compared (NaN)."""
REACH = 3
"""A line counts as drawn at a point if a pixel within this distance has its colour [px of the screen]."""


def picture_of(screenshot: bytes, place: tuple[float, float, float, float]) -> NDArray[np.uint8]:
    """Cut the camera's picture out of a screenshot. place: its x, y, width, height [px]. Returns (h, w, 3) RGB."""
    screen = cv2.imdecode(np.frombuffer(screenshot, np.uint8), cv2.IMREAD_COLOR)
    assert screen is not None
    x, y, width, height = (round(value) for value in place)
    return np.asarray(cv2.cvtColor(screen[y : y + height, x : x + width], cv2.COLOR_BGR2RGB), dtype=np.uint8)


def drawn_shares(
    picture: NDArray[np.uint8],
    context: RunContext,
    calibration: CameraCalibration,
    covered: tuple[float, float] | None = None,
) -> Mapping[str, float]:
    """Return for each line of the plan the share of its points at which the picture has the line's colour.

    The lines come from the plan's data, projected here: the garment's outline, the arc of each hand, and the
    predicted outline, which is dashed. Points at which another line passes are left out, because only one of both
    can be seen there. Names of points cover some of a line. covered: rows (from, to) of the picture that the page
    covers with the note about its age, which are left out.
    """
    attempt, frame = context.fold.attempt, context.sight.frame
    assert attempt is not None and frame is not None
    drawing = ProjectedDrawing(frame, calibration)
    scale = picture.shape[1] / drawing.picture.shape[1]
    lines: dict[str, tuple[Array, tuple[int, int, int]]] = {}
    garment = present_outline(context)
    if garment is not None:
        lines["garment"] = garment, OUTLINE
    for side, posture in attempt.motion.postures.items():
        lines[f"{side.value} arc"] = attempt.paths[posture.path].position, ARCS[side]
    contour = max(outline(attempt.predicted.vertices, attempt.predicted.triangles), key=len)
    lines["after the fold"] = contour, EXPECTED
    pixels = {name: _dense(scale * drawing.pixels(points)) for name, (points, _) in lines.items()}
    return {
        name: _share(picture, _uncovered(_alone(name, pixels), covered), colour)
        for name, (_, colour) in lines.items()
    }


def _dense(pixels: Array) -> Array:
    """Return points (m, 2) [px] along a line (n, 2), two pixels apart."""
    pixels = pixels[np.all(np.isfinite(pixels), axis=1)]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    at = np.arange(0.0, s[-1], 2.0)
    return np.column_stack([np.interp(at, s, column) for column in pixels.T])


def _uncovered(pixels: Array, covered: tuple[float, float] | None) -> Array:
    if covered is None:
        return pixels
    return pixels[(pixels[:, 1] < covered[0] - CLEAR) | (pixels[:, 1] > covered[1] + CLEAR)]


def _alone(name: str, pixels: Mapping[str, Array]) -> Array:
    """Return the points of a line that are CLEAR from all other lines."""
    others = np.vstack([points for other, points in pixels.items() if other != name])
    distance = np.linalg.norm(pixels[name][:, None] - others[None], axis=2).min(axis=1)
    return np.asarray(pixels[name][distance > CLEAR])


def _share(picture: NDArray[np.uint8], pixels: Array, colour: tuple[int, int, int]) -> float:
    """Return the share of the places (n, 2) [px] near which the picture has this colour; NaN for a few places."""
    near = np.linalg.norm(picture.astype(np.float64) - np.asarray(colour), axis=2) < TOLERANCE
    size = 2 * REACH + 1
    grown = cv2.dilate(near.astype(np.uint8), np.ones((size, size), np.uint8))
    seen = pixels[np.all(np.isfinite(pixels), axis=1)].astype(int)
    height, width = grown.shape
    inside = (seen[:, 0] >= 0) & (seen[:, 0] < width) & (seen[:, 1] >= 0) & (seen[:, 1] < height)
    found = grown[seen[inside, 1], seen[inside, 0]]
    return float(np.mean(found)) if len(found) >= FEWEST else float("nan")
