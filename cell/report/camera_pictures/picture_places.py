"""Converts places of a camera picture to points of the table, and back."""

from __future__ import annotations

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.vocabulary import CameraCalibration

__all__ = ["on_picture", "on_table"]


def on_picture(points: Array, calibration: CameraCalibration) -> Array:
    """Return the places (n, 2) of points (n, 2) on the table [m], as shares (0..1) of the picture's width and
    height."""
    k, T = calibration.intrinsics, np.linalg.inv(calibration.T_table_camera)
    seen = np.column_stack([points, np.zeros(len(points))]) @ T[:3, :3].T + T[:3, 3]
    pixels = np.array([k.fx, k.fy]) * seen[:, :2] / seen[:, 2:] + np.array([k.cx, k.cy])
    return np.asarray((pixels + 0.5) / np.array([k.width, k.height]))


def on_table(place: tuple[float, float], calibration: CameraCalibration) -> tuple[float, float] | None:
    """Return the point (x, y) of the table [m] at a place of the picture: the inverse of `on_picture`. None if the
    ray does not meet the table."""
    k, T = calibration.intrinsics, calibration.T_table_camera
    u, v = place[0] * k.width - 0.5, place[1] * k.height - 0.5
    ray = T[:3, :3] @ np.array([(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0])
    if ray[2] >= 0.0:
        return None
    point = T[:3, 3] - T[2, 3] / ray[2] * ray
    return float(point[0]), float(point[1])
