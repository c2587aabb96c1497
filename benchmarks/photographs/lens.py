"""A camera over the table: a pinhole with slight radial distortion. And what lens, sensor and file do to
a picture.

Table frame: x away from the photographer, y to the left, z up, metres. The upper edge of a picture is the far one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points


@dataclass(frozen=True)
class Camera:
    width: int
    height: int
    view_deg: float
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    k1: float = 0.0
    roll_deg: float = 0.0
    """Of the camera about its axis, clockwise."""

    @property
    def focal(self) -> float:
        return self.width / 2 / float(np.tan(np.radians(self.view_deg) / 2))

    @property
    def axes(self) -> Points:
        """Rows: the picture's right, down and forward directions in the table frame."""
        forward = np.subtract(self.target, self.position)
        forward = forward / np.linalg.norm(forward)
        far = np.array([1.0, 0.0, 0.0])
        up = far - far @ forward * forward
        up /= np.linalg.norm(up)
        right, c, s = np.cross(forward, up), np.cos(np.radians(self.roll_deg)), np.sin(np.radians(self.roll_deg))
        return np.array([c * right - s * up, -c * up - s * right, forward])

    @property
    def homography(self) -> Points:
        """(3, 3): from table metres (x, y, 1) to the pixels of the same camera without distortion."""
        k = np.array([[self.focal, 0, (self.width - 1) / 2], [0, self.focal, (self.height - 1) / 2], [0, 0, 1]])
        axes = self.axes
        return np.asarray(k @ np.column_stack([axes[:, 0], axes[:, 1], -axes @ np.array(self.position)]))

    def pixels(self, table: Points) -> Points:
        """Pixels (column, row) of points on the table (n, 2) [m]."""
        return self._distort(through(self.homography, table))

    def on_table(self, pixels: Points) -> Points:
        """Points on the table [m] that the pixels (n, 2) show."""
        straight = pixels
        for _ in range(5):  # the distortion is slight, so this converges
            straight = straight + pixels - self._distort(straight)
        return through(np.linalg.inv(self.homography), straight)

    def _distort(self, pixels: Points) -> Points:
        middle = np.array([self.width - 1, self.height - 1]) / 2
        ray = (pixels - middle) / self.focal
        return np.asarray(middle + self.focal * ray * (1 + self.k1 * np.sum(ray**2, axis=1, keepdims=True)))


def through(homography: Points, points: Points) -> Points:
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def random_camera(rng: np.random.Generator, outline: Points, tilt_deg: float, size: tuple[int, int]) -> Camera:
    """A camera that sees the whole garment with some margin, tilted by `tilt_deg` from straight down."""
    width, height = size
    view = rng.uniform(42, 68)
    k1 = rng.normal(0, 0.015)
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2 + rng.normal(0, 0.015, 2)
    margin = rng.uniform(0.06, 0.16)
    tilt = np.radians(tilt_deg)
    for distance in np.arange(0.6, 6.0, 0.02):
        position = (middle[0] - distance * np.sin(tilt), middle[1], distance * np.cos(tilt))
        camera = Camera(
            width, height, float(view), tuple(map(float, position)), (*map(float, middle), 0.0), float(k1)
        )
        at = camera.pixels(outline) / [width, height]
        if at.min() > margin and at.max() < 1 - margin:
            return camera
    raise ValueError("no camera sees the whole garment")


def expose(rng: np.random.Generator, light: Field) -> Field:
    """The 8-bit picture that a camera makes of the light (rows, columns, 3; 0 to 1, blue first)."""
    rows, columns = light.shape[:2]
    blur = rng.uniform(0.4, 1.1) * columns / 1280
    seen = cv2.GaussianBlur(light, (0, 0), blur)
    v, u = np.mgrid[:rows, :columns].astype(np.float32)
    radius = ((u - columns / 2) ** 2 + (v - rows / 2) ** 2) / (columns / 2) ** 2
    seen = seen * (1 - rng.uniform(0.03, 0.16) * radius)[..., None]
    shot = rng.uniform(0.006, 0.018)
    seen = seen + rng.standard_normal(seen.shape, dtype=np.float32) * shot * np.sqrt(np.clip(seen, 0.02, 1))
    picture = np.clip(seen * 255, 0, 255).astype(np.uint8)
    _, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(72, 96))])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))
