"""The result of a segmentation, and the clean-up of raw masks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array

__all__ = [
    "Field", "Image", "Mask", "Segmentation", "SegmentationSettings", "clean", "closed", "empty_segmentation",
    "eroded", "fill",
    "opened",
]  # fmt: skip

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Field = NDArray[np.floating]


@dataclass(frozen=True)
class SegmentationSettings:
    """Lengths [px] in view pixels; differences of colour as differences of the natural logarithm of intensity."""

    deepest_shadow: float = 1.0
    """Darkest possible shadow, as a decrease of the logarithm. With 1.0, a shaded table has at least exp(-1.0) =
    37 % of its unshaded intensity."""
    shadow_share: float = 0.05
    """Prior probability that a pixel of the table is in shadow."""
    surely_garment: float = 6.0
    """A pixel whose colour is further than this from every shade of the table is certainly garment [standard
    deviations]."""
    dark_offset: float = 0.04
    """A region that is darker than the table by more than this, and wider than `shadow_rim`, may be a dark
    garment."""
    shadow_rim: int = 13
    """Maximum width of the shadows that a flat garment casts [px]."""
    garment_height: float = 0.0006
    """A dark region whose mean height is above this is cloth, not shadow [m]."""
    smallest_area: int = 2500
    """A region that is smaller than this is not a garment [px^2]: 1 dm2 at 2 mm per pixel."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Result of a segmentation. mask: (H, W) bool, the garment. contour: (n, 2) sub-pixel (column, row), one point
    per pixel of the boundary; the first point is not repeated at the end.

    confidence: 0..1, the share of the boundary where cloth and table are distinguishable, times the garment's
    share of all foreground. An empty mask has confidence 0 and no contour. others: (H, W) bool, other objects on
    the table that are larger than a tenth of the smallest garment.
    """

    mask: Mask
    contour: Array
    confidence: float
    others: Mask

    @property
    def found(self) -> bool:
        return len(self.contour) > 0


def empty_segmentation(shape: tuple[int, ...]) -> Segmentation:
    """Return the result for the case that no garment was found in a view of this shape (H, W)."""
    return Segmentation(np.zeros(shape, bool), np.zeros((0, 2)), 0.0, np.zeros(shape, bool))


def clean(mask: Mask, settings: SegmentationSettings) -> tuple[Mask, Mask, float]:
    """Clean a mask (H, W) by closing and opening. Return the largest region without holes (H, W), the other large
    regions (H, W), and the largest region's share of them all."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    # Close by one pixel only: between the two legs of trousers just a narrow strip of table is visible, and a
    # wider closing would fill it.
    cleaned = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((2, 2), np.uint8))
    cleaned = cv2.morphologyEx(cleaned, cv2.MORPH_OPEN, kernel)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cleaned)
    areas = stats[1:, cv2.CC_STAT_AREA]
    if count < 2 or areas.max() < settings.smallest_area:
        return np.zeros(mask.shape, bool), np.zeros(mask.shape, bool), 0.0
    largest = (labels == 1 + int(np.argmax(areas))).astype(np.uint8)
    contours, _ = cv2.findContours(largest, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(largest, contours, -1, 1, thickness=cv2.FILLED)
    large = np.flatnonzero(areas > settings.smallest_area // 10)
    others = np.isin(labels, 1 + large[large != int(np.argmax(areas))]) & (largest == 0)
    return largest > 0, others, float(areas.max() / max(areas[large].sum(), areas.max()))


def fill(contour: Array, valid: Mask) -> Mask:
    """Return the mask (H, W) of the valid pixels whose centres lie within a sub-pixel contour (n, 2)."""
    # The contour is filled on a grid four times finer than the picture, because fillPoly also fills every cell
    # that the contour touches.
    fine = np.zeros((4 * valid.shape[0], 4 * valid.shape[1]), np.uint8)
    cv2.fillPoly(fine, [np.round((contour + 0.5) * 4 * 16 - 8).astype(np.int32)], 255, shift=4)
    image = cv2.resize(fine, (valid.shape[1], valid.shape[0]), interpolation=cv2.INTER_AREA)
    return (image > 127) & valid


def opened(mask: Mask, size: int) -> Mask:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0


def closed(mask: Mask, size: int) -> Mask:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0


def eroded(mask: Mask, reach: int) -> Mask:
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.erode(mask.astype(np.uint8), kernel, borderValue=0) > 0
