"""Rectifies a picture: resamples it to a view of the table with a fixed scale in metres.

In the pinhole model, a homography H = K (r1 r2 t) maps the table plane to the picture (Hartley and Zisserman,
Multiple View Geometry, section 8.1.1). If the picture is resampled by it, each pixel is a square of fixed size on
the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.vocabulary import CameraCalibration, Table

BELOW = 0.10
"""Measured points that lie further than this below the table's top are invalid [m], because the error of a
calibration is a few centimetres at most."""


@dataclass(frozen=True, eq=False)
class RectifiedView:
    """One picture in table coordinates.

    rgb: (H, W, 3) uint8. height: (H, W) float32 above the table [m], NaN where the sensor has no value or an
    impossible one, far below the table. valid: (H, W) bool, where the camera sees the table.
    """

    rgb: NDArray[np.uint8]
    height: NDArray[np.float32]
    valid: NDArray[np.bool_]


class TableView:
    """A view from straight above the table in the robot's orientation: far is up, left is left.

    Row 0 is at the table's largest x, column 0 at its largest y. pixel: edge of a pixel on the table [m]. Pixel
    coordinates are (column, row); integers are the pixels' centres. A point above the table appears where its line
    of sight meets z = 0, see `shadow_on_table`. Raises ValueError when a side of the table has fewer than 8
    pixels.
    """

    def __init__(self, calibration: CameraCalibration, table: Table, pixel: float = 0.002) -> None:
        self.pixel = pixel
        self.shape = (round((table.x[1] - table.x[0]) / pixel), round((table.y[1] - table.y[0]) / pixel))
        if min(self.shape) < 8:
            raise ValueError(f"table {table.x} x {table.y} m is too small for pixels of {pixel} m")
        self._x_far, self._y_left = table.x[1], table.y[1]
        self._calibration = calibration
        T_camera_table = np.linalg.inv(calibration.T_table_camera)
        self.camera_position: Array = np.asarray(calibration.T_table_camera)[:3, 3]
        self._project = calibration.intrinsics.matrix @ T_camera_table[:3]
        table_from_pixel = np.array(
            [[0.0, -pixel, self._x_far - 0.5 * pixel], [-pixel, 0.0, self._y_left - 0.5 * pixel], [0, 0, 1.0]]
        )
        self.homography: Array = self._project[:, [0, 1, 3]] @ table_from_pixel
        """(3, 3): view pixel (column, row, 1) -> camera pixel, up to scale."""
        self.valid = self._inside()

    def to_table(self, uv: Array, height: float | Array = 0.0) -> Array:
        """Convert view pixels (..., 2) (column, row) to positions (..., 2) [m], for points at `height` above the
        table [m].

        height: one value for all pixels, or (...).
        """
        uv = np.asarray(uv, dtype=float)
        x = self._x_far - (uv[..., 1] + 0.5) * self.pixel
        y = self._y_left - (uv[..., 0] + 0.5) * self.pixel
        on_table = np.stack([x, y], axis=-1)
        c = self.camera_position
        return c[:2] + (on_table - c[:2]) * (1.0 - np.asarray(height)[..., None] / c[2])

    def to_pixel(self, xy: Array) -> Array:
        """Convert points on the table (..., 2) [m] to view pixels (..., 2) (column, row)."""
        xy = np.asarray(xy, dtype=float)
        column = (self._y_left - xy[..., 1]) / self.pixel - 0.5
        row = (self._x_far - xy[..., 0]) / self.pixel - 0.5
        return np.stack([column, row], axis=-1)

    def at_height(self, xy: Array, height: float) -> Array:
        """Convert points (..., 2) at `height` above the table [m] to view pixels (..., 2), the inverse of
        `to_table`."""
        xy = np.asarray(xy, dtype=float)
        return self.to_pixel(self.shadow_on_table(np.concatenate([xy, np.full((*xy.shape[:-1], 1), height)], -1)))

    def to_image(self, xyz: Array) -> Array:
        """Convert points in the table frame (..., 2) or (..., 3) [m] to pixels (..., 2) of the camera's
        picture."""
        xyz = np.asarray(xyz, dtype=float)
        if xyz.shape[-1] == 2:
            xyz = np.concatenate([xyz, np.zeros_like(xyz[..., :1])], axis=-1)
        uvw = xyz @ self._project[:, :3].T + self._project[:, 3]
        return uvw[..., :2] / uvw[..., 2:]

    def from_image(self, uv: Array) -> Array:
        """Convert pixels (..., 2) of the camera's picture (column, row) to the points (..., 2) of the table that
        they show [m]."""
        uv = np.asarray(uv, dtype=float)
        homogeneous = np.concatenate([uv, np.ones_like(uv[..., :1])], axis=-1) @ np.linalg.inv(self.homography).T
        return self.to_table(homogeneous[..., :2] / homogeneous[..., 2:])

    def shadow_on_table(self, xyz: Array) -> Array:
        """Project points (..., 3) along the camera's lines of sight onto the plane z = 0: (..., 2) [m]. A point
        above the table appears at this place of the view."""
        xyz = np.asarray(xyz, dtype=float)
        c = self.camera_position
        scale = c[2] / np.maximum(c[2] - xyz[..., 2:], 1e-6)
        return c[:2] + (xyz[..., :2] - c[:2]) * scale

    def rectify(self, frame: CameraFrame) -> RectifiedView:
        """Resample one picture, colour bilinearly, depth (as height) by nearest neighbour."""
        size = (self.shape[1], self.shape[0])
        rgb = cv2.warpPerspective(
            frame.rgb,
            self.homography,
            size,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        height = cv2.warpPerspective(
            self._height(frame),
            self.homography,
            size,
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        return RectifiedView(rgb.astype(np.uint8, copy=False), height.astype(np.float32, copy=False), self.valid)

    def _height(self, frame: CameraFrame) -> NDArray[np.float32]:
        """Convert depth (H, W) along the optical axis to height (H, W) above the table [m], NaN for invalid
        points."""
        height = frame.depth * self._slope(frame) + np.float32(self._calibration.T_table_camera[2, 3])
        # A height can be far too low: a shiny table mirrors objects above it, and some drivers report their
        # largest range for missing values.
        return np.where(height > -BELOW, height, np.float32(np.nan))

    def depth_ratio(self, frame: CameraFrame) -> float:
        """Return the median ratio of the measured depth to the depth of the table on the same line of sight: 1 for
        an empty table, and NaN if nothing was measured."""
        ratio = frame.depth * self._slope(frame) / -np.float32(self._calibration.T_table_camera[2, 3])
        known = ratio[np.isfinite(ratio)]
        return float(np.median(known)) if len(known) else float("nan")

    def _slope(self, frame: CameraFrame) -> NDArray[np.float32]:
        """Return the change of height per depth (H, W) on the line of sight of each pixel."""
        k, T = self._calibration.intrinsics, self._calibration.T_table_camera
        rows, columns = frame.depth.shape
        across = T[2, 0] * (np.arange(columns) - k.cx) / k.fx
        down = T[2, 1] * (np.arange(rows) - k.cy) / k.fy
        return (across[None, :] + down[:, None] + T[2, 2]).astype(np.float32)

    def _inside(self) -> NDArray[np.bool_]:
        """Return whether each pixel of the view lies in the camera's picture, at least one camera pixel inside its
        border."""
        k = self._calibration.intrinsics
        rows, columns = self.shape
        c, r = np.arange(columns, dtype=np.float32)[None, :], np.arange(rows, dtype=np.float32)[:, None]
        u, v, w = (h[0] * c + (h[1] * r + h[2]) for h in self.homography.astype(np.float32))
        inside = (w > 0) & (u >= w) & (u <= (k.width - 2) * w) & (v >= w) & (v <= (k.height - 2) * w)
        inside.setflags(write=False)
        return inside
