"""Recognise a garment in the picture that the cell's camera would take of its template."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.config.cell_settings import CellSettings
from foldcell.cell.hardware.camera import camera_calibration
from foldcell.robots.errors import Failure
from foldcell.robots.ports import CameraFrame
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.perceive import perceive
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import CameraCalibration

TABLE, CLOTH = (170, 170, 170), (60, 90, 150)
"""Colours of the drawing."""
NOISE = 2.0
"""Standard deviation of the drawing's noise [levels of 256]. A picture without noise counts as artificial."""


def own_picture_refused(garment: Garment, settings: CellSettings) -> Failure | None:
    """Return why a run would not recognise the garment on a plain table in the middle of its poses; None if it
    would. Only the template is drawn, in colour and depth: no wrinkles, no shadow."""
    calibration = camera_calibration(settings)
    pixels = TableView(calibration, settings.table).to_image(garment.place(*garment.poses.middle))
    shape = (calibration.intrinsics.height, calibration.intrinsics.width)
    covered = np.zeros(shape, np.uint8)
    cv2.fillPoly(covered, [np.round(pixels).astype(np.int32)], 255, cv2.LINE_AA)
    share = covered[..., None] / 255.0
    top = garment.layers * garment.material.thickness
    table = _depth(0.0, calibration)
    depths = table, np.where(covered > 127, _depth(top, calibration), table)
    noise = np.random.default_rng(0).normal(0.0, NOISE, (2, *shape, 3))
    pictures = (TABLE + noise[0], share * CLOTH + (1.0 - share) * TABLE + noise[1])
    empty, laid = (
        CameraFrame(0.0, k, np.clip(rgb, 0, 255).astype(np.uint8), depth, calibration.intrinsics)
        for k, (rgb, depth) in enumerate(zip(pictures, depths, strict=True))
    )
    return perceive(
        laid, calibration, settings.table, empty, [garment], garment.name, settings=settings.perception.settings()
    ).failure


def _depth(height: float, calibration: CameraCalibration) -> NDArray[np.float32]:
    """Return the depth (H, W) [m] of a plane over the table [m]; NaN where the plane is not seen."""
    rows, columns = np.mgrid[: calibration.intrinsics.height, : calibration.intrinsics.width]
    rays = np.stack([columns, rows, np.ones(rows.shape)], axis=-1) @ np.linalg.inv(calibration.intrinsics.matrix).T
    down = rays @ calibration.T_table_camera[2, :3]
    depth = np.divide(
        height - calibration.T_table_camera[2, 3], down, where=down < 0.0, out=np.full(rows.shape, np.nan)
    )
    return depth.astype(np.float32)
