"""The table seen straight from above, as a picture from which a camera's picture is taken."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.photographs.lens import Camera
from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points

FINER = 4
"""Pixels of the grid on which polygons are filled, per pixel of the canvas."""


@dataclass(frozen=True, eq=False)
class Canvas:
    """Part of the table. Its rows run towards the photographer, its columns to the right. far_left: table point of
    the first pixel. pixel [m]: its size."""

    far_left: tuple[float, float]
    pixel: float
    shape: tuple[int, int]

    def at(self, table: Points) -> Points:
        """Canvas pixels (column, row) of points on the table [m]."""
        away = (np.array(self.far_left) - table) / self.pixel
        return np.asarray(away[:, ::-1])

    def mask(self, polygon: Points) -> Field:
        """Coverage of the polygon [m], 0 to 1."""
        # OpenCV fills every pixel that the border touches, which would make cloth wider, and the gap between two
        # legs narrower, by a pixel and a half. A grid four times finer leaves a quarter of a pixel of this.
        fine = np.zeros((FINER * self.shape[0], FINER * self.shape[1]), np.uint8)
        cv2.fillPoly(fine, [fixed((self.at(polygon) + 0.5) * FINER - 0.5)], 255, cv2.LINE_8, 4)
        return cv2.resize(fine, self.shape[::-1], interpolation=cv2.INTER_AREA).astype(np.float32) / 255

    def line(self, points: Points, width: float) -> Field:
        """Coverage of a line of that width [m]."""
        drawn = np.zeros(self.shape, np.uint8)
        thickness = max(1, round(width / self.pixel))
        cv2.polylines(drawn, [fixed(self.at(points))], False, 255, thickness, cv2.LINE_AA, 4)
        return drawn.astype(np.float32) / 255


def fixed(points: Points) -> NDArray[np.int32]:
    """Pixels in the fixed-point numbers (4 bits) of OpenCV's drawing functions."""
    return np.round(points * 16).astype(np.int32)


def under(camera: Camera, pixels: int = 1300, finest: float = 0.0008) -> Canvas:
    """The canvas that holds all that the camera sees. pixels: along its longer side, at most.
    finest [m]: smallest size of a pixel."""
    seen = footprint(camera)
    low, high = seen.min(axis=0) - 0.02, seen.max(axis=0) + 0.02
    pixel = max(float((high - low).max()) / pixels, finest)
    rows, columns = np.ceil((high - low) / pixel).astype(int)
    return Canvas((float(high[0]), float(high[1])), pixel, (int(rows), int(columns)))


def footprint(camera: Camera) -> Points:
    """The border of what the camera sees of the table [m], 4 times 20 points."""
    w, h = camera.width - 1, camera.height - 1
    t = np.linspace(0, 1, 20, endpoint=False)[:, None]
    ends = np.array([[0, 0], [w, 0], [w, h], [0, h], [0, 0]], float)
    border = np.vstack([(1 - t) * ends[i] + t * ends[i + 1] for i in range(4)])
    return camera.on_table(border)


def seen_from(canvas: Canvas, camera: Camera) -> Field:
    """(height, width, 2): the canvas pixel (column, row) that each pixel of the camera shows."""
    v, u = np.mgrid[: camera.height, : camera.width]
    table = camera.on_table(np.column_stack([u.ravel(), v.ravel()]).astype(float))
    return canvas.at(table).astype(np.float32).reshape(camera.height, camera.width, 2)


def photographed(drawn: Field, sight: Field) -> Field:
    """The canvas as the camera sees it, by `seen_from`."""
    seen = cv2.remap(drawn, sight[..., 0], sight[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.float32)
