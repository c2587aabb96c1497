"""Mount of the RGB-D camera on Baxter: a bracket above the head panel, which turns with the head.

The bracket holds the camera in front of the panel's upper edge, which reaches x = 0.216, z = 0.765 in the base
frame. If the camera were further back, the panel would hide the near half of the table.
"""

from __future__ import annotations

import numpy as np

from robots.ports import Array, Intrinsics, frozen

__all__ = [
    "HEAD_ORIGIN",
    "INTRINSICS",
    "T_HEAD_CAMERA",
    "T_base_camera",
    "T_base_head",
    "look_at",
]

FIELD_OF_VIEW = np.radians((58.0, 45.0))
"""Field of view of a PrimeSense Xtion, horizontal and vertical [rad]."""

INTRINSICS = Intrinsics(
    width=640,
    height=480,
    fx=float(320.0 / np.tan(FIELD_OF_VIEW[0] / 2)),
    fy=float(240.0 / np.tan(FIELD_OF_VIEW[1] / 2)),
    cx=319.5,
    cy=239.5,
)

HEAD_ORIGIN = (0.06, 0.0, 0.686)
"""Position of the URDF's head_pan joint in the base frame [m]. It rotates about z."""

EYE, TARGET = (0.25, 0.0, 1.00), (0.60, 0.0, -0.10)
"""Position of the camera, and the point that it looks at, with the head straight ahead. Base frame [m]."""


def look_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Array:
    """Return the pose (4, 4) of a camera (OpenCV axes) at `eye` that looks at `target`. The upper edge of its
    picture is towards base x."""
    z = np.subtract(target, eye)
    z = z / np.linalg.norm(z)
    right = np.cross(z, (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.column_stack((right, np.cross(z, right), z))
    T[:3, 3] = eye
    return T


def T_base_head(pan: float) -> Array:
    """Return the pose (4, 4) of the head link at `pan` [rad], in the base frame."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(pan), -np.sin(pan)], [np.sin(pan), np.cos(pan)]]
    T[:3, 3] = HEAD_ORIGIN
    return T


T_HEAD_CAMERA = frozen(np.linalg.inv(T_base_head(0.0)) @ look_at(EYE, TARGET))
"""Design pose (4, 4) of the camera relative to the head link."""


def T_base_camera(pan: float = 0.0) -> Array:
    """Return the nominal pose (4, 4) of the camera in the base frame, with the head at `pan` [rad]."""
    return T_base_head(pan) @ T_HEAD_CAMERA
