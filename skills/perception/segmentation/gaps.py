"""Opens gaps between limbs that touch further out: the ground seen between two legs, or between sleeve and body.

Where limbs touch, such a gap is a hole of a segmentation, and holes are filled because prints look like them. A
gap is long and narrow, has the colours of the ground around the garment, and points to a near place on the
outline.
"""

from __future__ import annotations

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.boundary import longest_contour, refine_boundary
from foldcell.skills.perception.segmentation.colour_model import colour_likelihood, log_colour, noise_scale
from foldcell.skills.perception.segmentation.mask import Image, Mask, Segmentation, eroded, fill, largest

_RING = 24
"""Width of the ring around a garment whose colours are the ground's [px]."""
_EDGE = 3
"""Pixels nearer to the outline than this are mixtures [px]."""
_SHORTEST = 0.10
"""Least length of a gap, relative to the root of the garment's area."""
_SLENDER = 3.0
"""Least ratio of a gap's length to its mean width."""
_REACH = 0.30
"""Limbs touch along at most this length, relative to the root of the garment's area."""
_AHEAD = 0.8
"""Least cosine of the angle between a gap and the line from its end to the outline."""


def opened_gaps(found: Segmentation, rgb: Image, valid: Mask) -> Segmentation | None:
    """Return a segmentation of rgb (H, W, 3) with its gaps opened to the outline; None if there are none."""
    root = float(np.sqrt(np.count_nonzero(found.mask)))
    holes = _holes(found.mask, rgb, valid)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(holes.astype(np.uint8))
    mask, opened = found.mask.copy(), False
    gaps = [
        np.argwhere(labels == i)[:, ::-1].astype(float)
        for i in range(1, count)
        if stats[i, cv2.CC_STAT_AREA] > _EDGE**2
    ]
    for pixels in sorted((g for g in gaps if _slender(g, root)), key=len, reverse=True):
        bridge = _bridge(pixels, longest_contour(mask), _REACH * root)
        if bridge is not None:
            cut = mask.astype(np.uint8)
            cut[tuple(pixels[:, ::-1].astype(int).T)] = 0
            cv2.line(cut, *bridge, 0, 2)
            mask, opened = largest(cut > 0), True
    if not opened:
        return None
    contour, clear = refine_boundary(mask, rgb, None)
    return Segmentation(fill(contour, valid), contour, clear, found.others)


def _holes(mask: Mask, rgb: Image, valid: Mask) -> Mask:
    """Return the pixels (H, W) within a mask that rather have the colours of the ground around it."""
    around = valid & ~cv2.dilate(mask.astype(np.uint8), np.ones((2 * _EDGE + 1, 2 * _EDGE + 1))).astype(bool)
    around &= cv2.dilate(mask.astype(np.uint8), np.ones((2 * _RING + 1, 2 * _RING + 1))) > 0
    core = eroded(mask, _EDGE)
    if min(np.count_nonzero(around), np.count_nonzero(core)) < 500:
        return np.zeros(mask.shape, bool)
    image, noise = log_colour(rgb), noise_scale(rgb)
    odds = colour_likelihood(image, noise, around) - colour_likelihood(image, noise, core)
    return np.asarray((cv2.GaussianBlur(odds, (0, 0), 0.8) > 0) & core)


def _slender(pixels: Array, root: float) -> bool:
    _, sides, _ = cv2.minAreaRect(pixels.astype(np.float32))
    length = max(sides) + 1.0
    return length > _SHORTEST * root and length**2 > _SLENDER * len(pixels)


def _bridge(pixels: Array, outline: Array, reach: float) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Return the shortest line from an end of a gap to the outline ahead of it, at most `reach` long [px]."""
    best: tuple[float, Array, Array] | None = None
    middle = pixels.mean(axis=0)
    axis = np.linalg.svd(pixels - middle, full_matrices=False)[2][0]
    for way in (axis, -axis):
        end = pixels[np.argmax((pixels - middle) @ way)]
        away = outline - end
        length = np.linalg.norm(away, axis=1)
        length[away @ way < _AHEAD * length] = np.inf
        nearest = int(np.argmin(length))
        if length[nearest] < (reach if best is None else best[0]):
            best = length[nearest], end, outline[nearest]
    if best is None:
        return None
    (x, y), (u, v) = best[1].astype(int).tolist(), best[2].astype(int).tolist()
    return (x, y), (u, v)
