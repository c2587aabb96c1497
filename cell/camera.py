"""What the executive believes of its camera before anybody calibrated it: the drawing of its bracket."""

from __future__ import annotations

import numpy as np

from robots.baxter.camera_mount import INTRINSICS, T_base_camera
from skills.vocabulary import CameraCalibration, Table, frozen

__all__ = ["nominal_calibration"]


def nominal_calibration(table: Table) -> CameraCalibration:
    """The camera's nominal pose in the table frame, for the head looking straight ahead."""
    return CameraCalibration(
        intrinsics=INTRINSICS,
        T_table_camera=frozen(np.linalg.inv(table.T_base_table) @ T_base_camera(0.0)),
        head_pan=0.0,
    )
