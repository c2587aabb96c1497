"""Segments a garment that has the colour of even ground, such as white on white, by its edges.

Folds shade the cloth by more than it differs from the ground, so its colours do not show where it ends. A sharp
edge does: a thin line of shadow on one side, a step of light on the other. Coming from outside over even ground,
the first sharp edge is the garment's, whatever is printed on the cloth.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import outward_normals, smooth_closed
from foldcell.skills.perception.registration.boundary import longest_contour, sample
from foldcell.skills.perception.segmentation.mask import (
    SMALLEST_AREA,
    Field,
    Image,
    Mask,
    Segmentation,
    closed,
    eroded,
    fill,
    filled,
    largest,
    opened,
)

_RIM = 0.06
"""Width of the rim that is assumed to show mostly ground, relative to the longer edge."""
_EVEN, _ROUNDING = 12.0, 4.0
"""The ground is even if 95 % of its rim are less steep than the first. White desks are at 4 to 11; joints of
boards and tiles, folds of bed linen and wood are at 13 and more. The second is the steepness that rounding makes
[grey levels, Sobel]."""
_EDGE = 2.0
"""An edge is steeper than 90 % of the rim everywhere, and so many times as steep somewhere: the two thresholds of
Canny (A computational approach to edge detection, 1986), who advises two to three."""
_GAP, _WIDE_GAP, _BORDER = 5, 11, 4
"""Gaps in an edge that are narrower than the first are closed, and what is narrower is no cloth. If the region is
larger when gaps up to the second are closed, it is a part of something; what is apart then is another thing. A
region that comes as near to the border of the picture as the third may go on beyond it [px]."""
_REACH, _BEND = 6.0, 0.3
"""The sharpest edge is sought so far on both sides of a region's outline [px]. The second is the price of a step
aside by one pixel from one place of the outline to the next, relative to a typical edge."""
_BESIDE = np.arange(4.0, 9.0)
"""Distances from the outline at which the colours on both sides are compared [px]. Shadows are narrower."""
_FAINT, _FAINT_SHARE = 20.0, 0.25
"""Steps of colour (Lab) that are smaller than the first hide in the shades of the folds [grey levels]. If a larger
share of the outline is faint than the second, colours do not show it."""


def segment_by_edges(rgb: Image, valid: Mask) -> Segmentation | None:
    """Segment what lies on even ground in rgb (H, W, 3), where valid (H, W). None if the ground is not even, if
    nothing whole is found, or if its colour differs clearly from the ground's, because then colours are more
    accurate.

    The confidence is the share of the outline that is an edge, times the share of the region in what its edges
    surround if wide gaps in them are closed. `others` is the largest other thing that lies wholly in the picture.
    """
    lab = cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 1.0), cv2.COLOR_RGB2LAB)
    colours = lab.astype(np.float32)
    across, down = cv2.Sobel(colours, cv2.CV_32F, 1, 0), cv2.Sobel(colours, cv2.CV_32F, 0, 1)
    steep = np.hypot(across, down).max(axis=2)  # as `cv2.Canny` measures it
    rim = valid & ~eroded(valid, round(_RIM * max(valid.shape)))
    usual, steepest = np.maximum(np.quantile(steep[rim], (0.9, 0.95)), _ROUNDING).tolist()
    if steepest > _EVEN:
        return None
    edges = (cv2.Canny(lab, usual, _EDGE * usual, L2gradient=True) > 0) & valid
    things, joined = (opened(filled(closed(edges, gap)), _GAP) for gap in (_GAP, _WIDE_GAP))
    mask, whole, border = largest(things), largest(joined), ~eroded(valid, _BORDER)
    if np.count_nonzero(mask) < SMALLEST_AREA or (mask & border).any():
        return None
    other = largest(things & ~whole & ~mask)
    line = _at_sharpest(longest_contour(mask), colours)
    away = _BESIDE[:, None] * outward_normals(smooth_closed(line, 3.0))[:, None]
    within, beyond = (sample(colours, line[:, None] + way * away).mean(axis=1) for way in (-1, 1))
    if np.mean(np.linalg.norm(within - beyond, axis=1) < _FAINT) < _FAINT_SHARE:
        return None
    clear = float(np.mean(sample(steep, line[None]) > _EDGE * usual))
    share = min(float(np.count_nonzero(mask) / np.count_nonzero(whole)), 1.0)
    return Segmentation(fill(line, valid), line, clear * share, other & ~(other & border).any())


def _at_sharpest(outline: Array, colours: Field) -> Array:
    """Return a closed outline (n, 2) moved to the sharpest edge near it, which runs beside it without jumps."""
    points = smooth_closed(outline, 2.0)
    normals, offsets = outward_normals(points), np.arange(-_REACH - 1.0, _REACH + 2.0)
    profile = sample(colours, points[:, None] + offsets[:, None] * normals[:, None])
    steps = smooth_closed(np.linalg.norm(profile[:, 2:] - profile[:, :-2], axis=2), 2.0)
    sharp = np.minimum(steps / max(float(np.median(steps.max(axis=1))), 1e-6), 1.0)
    path = cheapest_path(np.tile(-sharp, (3, 1)), _BEND)[len(sharp) : 2 * len(sharp)]  # its ends meet
    return smooth_closed(points + offsets[1 + path, None] * normals, 1.0)


def cheapest_path(cost: Array, price: float) -> NDArray[np.int_]:
    """Return the columns (n,) of the cheapest path down a table (n, m), by dynamic programming. It moves aside by
    at most one column a row, at a price."""
    columns, total = np.arange(cost.shape[1]), cost[0]
    moves = np.zeros(cost.shape, int)
    for row in range(1, len(cost)):
        padded = np.pad(total, 1, constant_values=np.inf)
        ways = np.stack([padded[:-2] + price, total, padded[2:] + price])
        moves[row] = np.argmin(ways, axis=0) - 1
        total = ways[moves[row] + 1, columns] + cost[row]
    path = np.full(len(cost), np.argmin(total))
    for row in range(len(cost) - 1, 0, -1):
        path[row - 1] = path[row] + moves[row, path[row]]
    return path
