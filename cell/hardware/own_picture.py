"""Recognise a garment in the picture that the cell's camera would take of its template."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.config.cell_settings import CellSettings
from cell.hardware.camera import camera_calibration
from cell.hardware.photograph import Photograph, perceive_photograph
from robots.errors import Failure
from robots.ports import Array
from skills.garments.garment import Garment

__all__ = ["own_picture_refused"]

TABLE, CLOTH = (170, 170, 170), (60, 90, 150)
"""Colours of the drawing."""
NOISE = 2.0
"""Standard deviation of the drawing's noise [levels of 256]. A picture without noise counts as artificial."""


def own_picture_refused(file: str, garment: Garment, settings: CellSettings) -> Failure | None:
    """Return why the garment is not recognised on a plain table in the middle of its poses; None if it is
    recognised. file: its name or file. Nothing but the template is drawn: no wrinkles, no shadow, no depth."""
    calibration = camera_calibration(settings)
    corners = garment.place(*garment.poses.middle)
    pixels = _projected(corners, calibration.T_table_camera, calibration.intrinsics.matrix)
    shape = (calibration.intrinsics.height, calibration.intrinsics.width, 3)
    noise = np.random.default_rng(0).normal(0.0, NOISE, (2, *shape))
    empty, laid = (np.full(shape, TABLE, np.uint8) for _ in range(2))
    cv2.fillPoly(laid, [np.round(pixels).astype(np.int32)], CLOTH, cv2.LINE_AA)
    pictures = [
        Photograph(np.clip(picture + grain, 0, 255).astype(np.uint8), None, name, "")
        for picture, grain, name in zip((empty, laid), noise, ("table", garment.name), strict=True)
    ]
    return perceive_photograph(pictures[1], pictures[0], file, "m", settings)[0].failure


def _projected(points: Array, T_table_camera: Array, matrix: Array) -> NDArray[np.float64]:
    """Return the pixels (n, 2) of points (n, 2) on the table."""
    there = (
        np.column_stack([points, np.zeros(len(points)), np.ones(len(points))]) @ np.linalg.inv(T_table_camera).T
    )
    seen = there[:, :3] @ matrix.T
    return np.asarray(seen[:, :2] / seen[:, 2:])
