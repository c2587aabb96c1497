"""The picture in which those details of a garment are located that its outline does not show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.boundary import sample


@dataclass(frozen=True, eq=False)
class ClothPicture:
    """rgb: (H, W, 3) uint8, table and garment from above. mask: (H, W) bool, the garment. to_pixel: converts
    points (n, 2) of the garment [m] to pixels (n, 2), column and row.

    photo: (rows, columns, 3) uint8, the camera's own picture, which can be finer than `rgb`. to_photo: converts
    points to pixels of `photo`.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    to_pixel: Callable[[Array], Array]
    photo: NDArray[np.uint8]
    to_photo: Callable[[Array], Array]

    def pixels(self, points: Array) -> NDArray[np.float32]:
        """Convert points (..., 2) [m] to pixels (..., 2)."""
        return self.to_pixel(points.reshape(-1, 2)).reshape(points.shape).astype(np.float32)

    def colours(self, points: Array) -> Array:
        """Sample the colours (n, m, 3) at points (n, m, 2) [m], in the finest picture there is."""
        return sample(self.photo, self.to_photo(points.reshape(-1, 2)).reshape(points.shape))

    def cloth(self, points: Array) -> Array:
        """Return how much of the surroundings of points (n, m, 2) [m] belongs to the garment, (n, m) 0..1."""
        return sample(self.mask.astype(np.float32), self.pixels(points))
