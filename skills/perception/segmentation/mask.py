"""The result of a segmentation, and the operations on masks that the methods share."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.boundary import refine_boundary

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Field = NDArray[np.floating]


SMALLEST_AREA = 2500
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

    @property
    def others_share(self) -> float:
        """Area of the other objects, relative to that of the garment."""
        return float(np.count_nonzero(self.others) / np.count_nonzero(self.mask))


def empty_segmentation(shape: tuple[int, ...]) -> Segmentation:
    """Return the result for the case that no garment was found in a view of this shape (H, W)."""
    return Segmentation(np.zeros(shape, bool), np.zeros((0, 2)), 0.0, np.zeros(shape, bool))


def outlined(raw: Mask, rgb: Image, valid: Mask, table: NDArray[np.float32] | None = None) -> Segmentation:
    """Make a segmentation from a raw mask (H, W) of cloth: its largest region, with the boundary where the colours
    of rgb (H, W, 3) change. table: (H, W, 3), see `refine_boundary`."""
    mask, others, share = _clean(raw)
    if not mask.any():
        return empty_segmentation(valid.shape)
    contour, clear_share = refine_boundary(mask, rgb, table)
    return Segmentation(fill(contour, valid), contour, share * clear_share, others)


def _clean(mask: Mask) -> tuple[Mask, Mask, float]:
    """Clean a mask (H, W) by closing and opening. Return the largest region without holes (H, W), the other large
    regions (H, W), and the largest region's share of them all."""
    # Close by one pixel only: between the two legs of trousers just a narrow strip of table is visible, and a
    # wider closing would fill it.
    cleaned = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((2, 2), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened(cleaned > 0, 5).astype(np.uint8))
    areas = stats[1:, cv2.CC_STAT_AREA]
    if count < 2 or areas.max() < SMALLEST_AREA:
        return np.zeros(mask.shape, bool), np.zeros(mask.shape, bool), 0.0
    largest = filled(labels == 1 + int(np.argmax(areas)))
    large = np.flatnonzero(areas > SMALLEST_AREA // 10)
    others = np.isin(labels, 1 + large[large != int(np.argmax(areas))]) & ~largest
    return largest, others, float(areas.max() / max(areas[large].sum(), areas.max()))


def filled(mask: Mask) -> Mask:
    """Return the mask (H, W) without its holes."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = mask.astype(np.uint8)
    cv2.drawContours(out, contours, -1, 1, thickness=cv2.FILLED)
    return out > 0


def reduced(rgb: Image, valid: Mask, longer: int) -> tuple[Image, Mask]:
    """Reduce a picture (H, W, 3) and its mask (H, W), so that the longer edge has `longer` pixels at most."""
    scale = min(longer / max(valid.shape), 1.0)
    size = (max(round(valid.shape[1] * scale), 8), max(round(valid.shape[0] * scale), 8))
    inside = cv2.resize(valid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), inside


def graph_cut(picture: Image, labels: NDArray[np.uint8], rounds: int) -> Mask:
    """Cut the cloth (H, W) out of a picture (H, W, 3) by GrabCut (Rother, Kolmogorov and Blake, SIGGRAPH 2004).
    labels: (H, W), OpenCV's GC_ labels to start from; they are changed."""
    cv2.setRNGSeed(0)  # GrabCut initialises its colour clusters at random
    clusters = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(picture, labels, (0, 0, 0, 0), *clusters, rounds, cv2.GC_INIT_WITH_MASK)
    return np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))


def fill(contour: Array, valid: Mask) -> Mask:
    """Return the mask (H, W) of the valid pixels whose centres lie within a sub-pixel contour (n, 2)."""
    # The contour is filled on a grid four times finer than the picture, because fillPoly also fills every cell
    # that the contour touches.
    fine = np.zeros((4 * valid.shape[0], 4 * valid.shape[1]), np.uint8)
    cv2.fillPoly(fine, [np.round((contour + 0.5) * 4 * 16 - 8).astype(np.int32)], 255, shift=4)
    image = cv2.resize(fine, (valid.shape[1], valid.shape[0]), interpolation=cv2.INTER_AREA)
    return (image > 127) & valid


def largest(mask: Mask) -> Mask:
    """Return the largest connected region of a mask (H, W), or the mask itself if it is empty."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return mask if count < 2 else np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def opened(mask: Mask, size: int) -> Mask:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0


def closed(mask: Mask, size: int) -> Mask:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0


def eroded(mask: Mask, reach: int) -> Mask:
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.erode(mask.astype(np.uint8), kernel, borderValue=0) > 0
