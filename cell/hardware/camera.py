"""Choose the camera's mount (as the settings state it, or the robot's own) and the executive's camera calibration:
from a calibration file, or the nominal one of the mount."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foldcell.cell.config.calibration_file import load_camera_calibration
from foldcell.cell.config.cell_settings import CellSettings
from foldcell.robots.camera_mount import CameraMount, look_at
from foldcell.robots.ports import Intrinsics
from foldcell.robots.registry import find_robot
from foldcell.skills.vocabulary import CameraCalibration, Table, frozen


def camera_mount(settings: CellSettings) -> CameraMount:
    """Return the camera's mount and lens as the settings state them, else as the robot's camera is drawn."""
    drawn, stated = find_robot(settings.robot).camera, settings.camera
    lens, T = drawn.intrinsics, drawn.T_head_camera
    if stated.width is not None and stated.height is not None:
        scale = stated.width / lens.width
        lens = pinhole(stated.width, stated.height, lens.fx * scale, lens.fy * scale)
    if stated.view_deg is not None:
        focal = 0.5 * lens.width / np.tan(0.5 * np.deg2rad(stated.view_deg))
        lens = pinhole(lens.width, lens.height, float(focal), float(focal))
    if stated.position is not None and stated.target is not None:
        # the table's height as drawn: a calibrated table is measured by this camera
        T_base_camera = settings.drawn_table.T_base_table @ look_at(stated.position, stated.target)
        T = frozen(np.linalg.inv(drawn.T_base_head(0.0)) @ T_base_camera)
    return replace(drawn, intrinsics=lens, T_head_camera=T)


def pinhole(width: int, height: int, fx: float, fy: float) -> Intrinsics:
    """Return the intrinsics of a lens without distortion whose axis meets the middle of the picture."""
    return Intrinsics(width, height, fx, fy, 0.5 * (width - 1), 0.5 * (height - 1))


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
    return nominal_calibration(camera_mount(settings), settings.table)
