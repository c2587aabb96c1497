"""The picture in which details of a garment are located that its outline does not show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array

__all__ = ["ClothPicture", "sample"]


@dataclass(frozen=True, eq=False)
class ClothPicture:
    """rgb: (H, W, 3) uint8, table and garment from above. mask: (H, W) bool, the garment. to_pixel: converts
    points (n, 2) of the garment [m] to pixels (n, 2), column and row.

    photo: (rows, columns, 3) uint8, the camera's own picture, which can be finer than `rgb`. to_photo: converts
    points to its pixels. Without them, `rgb` is used.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    to_pixel: Callable[[Array], Array]
    photo: NDArray[np.uint8] | None = None
    to_photo: Callable[[Array], Array] | None = None

    def pixels(self, points: Array) -> NDArray[np.float32]:
        """Convert points (..., 2) [m] to pixels (..., 2)."""
        return self.to_pixel(points.reshape(-1, 2)).reshape(points.shape).astype(np.float32)

    def colours(self, points: Array) -> Array:
        """Sample the colours (n, m, 3) at points (n, m, 2) [m], in the finest picture there is."""
        if self.photo is None or self.to_photo is None:
            return sample(self.rgb, self.pixels(points))
        return sample(self.photo, self.to_photo(points.reshape(-1, 2)).reshape(points.shape).astype(np.float32))

    def cloth(self, points: Array) -> Array:
        """Return how much of the surroundings of points (n, m, 2) [m] belongs to the garment, (n, m) 0..1."""
        return sample(self.mask.astype(np.float32), self.pixels(points))


def sample(image: NDArray[np.uint8] | NDArray[np.float32], pixels: NDArray[np.float32]) -> Array:
    """Sample an image (H, W) or (H, W, channels) at pixels (n, m, 2), bilinearly; outside the image, the nearest
    pixel counts. Returns (n, m) or (n, m, channels)."""
    columns, rows = pixels[..., 0], pixels[..., 1]
    return cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
