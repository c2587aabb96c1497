"""Mount of the cell's RGB-D camera: on the robot's head, or fixed in the base frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foldcell.robots.ports import Array, Intrinsics

_VIEW = np.radians((58.0, 45.0))
XTION = Intrinsics(
    width=640,
    height=480,
    fx=float(320.0 / np.tan(_VIEW[0] / 2)),
    fy=float(240.0 / np.tan(_VIEW[1] / 2)),
    cx=319.5,
    cy=239.5,
)
"""The lens of a PrimeSense Xtion, with the field of view of its data sheet: 58 x 45 degrees."""


@dataclass(frozen=True, eq=False)
class CameraMount:
    """The camera as it is drawn, before any calibration.

    intrinsics: of the data sheet. T_head_camera: design pose (4, 4) relative to the head link. head_joint: the
    URDF's name of the joint that turns the head about z; None if the camera does not move, in which case the head
    link is the base frame. head_origin: position of this joint in the base frame [m].
    """

    intrinsics: Intrinsics
    T_head_camera: Array
    head_joint: str | None = None
    head_origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def T_base_head(self, pan: float) -> Array:
        """Return the pose (4, 4) of the head link at `pan` [rad], in the base frame."""
        T = np.eye(4)
        if self.head_joint is not None:
            T[:2, :2] = [[np.cos(pan), -np.sin(pan)], [np.sin(pan), np.cos(pan)]]
        T[:3, 3] = self.head_origin
        return T

    def T_base_camera(self, pan: float = 0.0) -> Array:
        """Return the nominal pose (4, 4) of the camera in the base frame, with the head at `pan` [rad]."""
        return self.T_base_head(pan) @ self.T_head_camera


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
