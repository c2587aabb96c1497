"""Mount of the RGB-D camera on Baxter: a bracket above the head panel, which turns with the head.

The bracket holds the camera in front of the panel's upper edge, which reaches x = 0.216, z = 0.765 in the base
frame. If the camera were further back, the panel would hide the near half of the table.
"""

from __future__ import annotations

import numpy as np

from foldcell.robots.camera_mount import XTION, CameraMount, look_at
from foldcell.robots.ports import frozen

__all__ = ["MOUNT"]

HEAD_ORIGIN = (0.06, 0.0, 0.686)
"""Position of the URDF's head_pan joint in the base frame [m]. It rotates about z."""

EYE, TARGET = (0.25, 0.0, 1.00), (0.60, 0.0, -0.10)
"""Position of the camera, and the point that it looks at, with the head straight ahead. Base frame [m]."""

_T_BASE_HEAD = np.eye(4)
_T_BASE_HEAD[:3, 3] = HEAD_ORIGIN

MOUNT = CameraMount(
    intrinsics=XTION,
    T_head_camera=frozen(np.linalg.inv(_T_BASE_HEAD) @ look_at(EYE, TARGET)),
    head_joint="head_pan",
    head_origin=HEAD_ORIGIN,
)
"""The design of the bracket."""
