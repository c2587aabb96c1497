"""Choose the executive's camera calibration: from a calibration file, or the nominal one from the drawing of the
camera's mount."""

from __future__ import annotations

import numpy as np

from cell.config.calibration_file import load_camera_calibration
from cell.config.cell_settings import CellSettings
from robots.camera_mount import CameraMount
from robots.registry import find_robot
from skills.vocabulary import CameraCalibration, Table, frozen

__all__ = ["camera_calibration", "nominal_calibration"]


def nominal_calibration(mount: CameraMount, table: Table) -> CameraCalibration:
    """Return the nominal calibration: data-sheet intrinsics, and the camera's design pose in the table frame for
    the head looking straight ahead."""
    return CameraCalibration(
        intrinsics=mount.intrinsics,
        T_table_camera=frozen(np.linalg.inv(table.T_base_table) @ mount.T_base_camera(0.0)),
        head_pan=0.0,
    )


def camera_calibration(settings: CellSettings) -> CameraCalibration:
    """Return the calibration from the file that the settings name, or the nominal calibration if they name
    none."""
    if settings.camera.calibration is not None:
        return load_camera_calibration(settings.camera.calibration, settings.table)
    return nominal_calibration(find_robot(settings.robot).camera, settings.table)
