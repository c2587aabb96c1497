"""Locates a shoulder at the upper end of the seam between sleeve and body, which runs from there to the armpit.

The outline of a shirt hardly bends at the shoulder, but in many pictures the seam is visible as a dark line.
Curves from each place of the outline near the shoulder to the armpit, with several curvatures, are compared with
the picture: along the seam, nearly every point is darker than the points on both sides of it. A pattern can have
dark lines, too, so that the seam counts only if it is dark along its whole length, and if no other curve is nearly
as dark.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.boundary import sample
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.energy import Boundary

__all__ = ["locate_seam"]


_SEARCH = 0.040  # maximum displacement along the outline [m]
_BOW = 0.024  # maximum sagitta of a seam [m]
_BESIDE = 0.005  # distance of the points with which a point of the seam is compared [m]
_MARGIN = 0.008  # distance from the outline at which a seam is looked for [m]
_PART = 0.8  # share of the seam's length, from the shoulder, that is compared: the armpit is not known exactly
_NOISE = 0.5  # standard deviation of the noise of a pixel's brightness [grey levels]
_EVIDENCE = 30.0
"""Minimum evidence for a seam: the squared darkness of the line, relative to the variation of the cloth, times its
length in units of 16 mm."""
_COMPLETE = 0.9
"""Minimum share of points that are dark."""
_RIVAL, _ELSEWHERE = 0.75, 0.010
"""If a line ends at least `_ELSEWHERE` [m] away from the end of the seam, its evidence must not exceed the share
`_RIVAL` of the seam's evidence."""
_SAMPLES, _BOWS = 36, 13
"""Number of points on a curve, and number of curves of different curvature that end at one point of the
boundary."""
_STRIDE = 2
"""Curves end at every second point of the boundary."""


def locate_seam(picture: ClothPicture, boundary: Boundary, shoulder: Array, armpit: Array) -> Array | None:
    """Find the place (2,) [m] on the boundary where the seam from the armpit (2,) ends, near `shoulder` (2,). None
    if there is no seam or more than one."""
    step = _STRIDE * boundary.length / len(boundary.points)
    start = int(boundary.nearest(shoulder[None])[1][0])
    last = int(_SEARCH / step)
    ends = boundary.points[(start + _STRIDE * np.arange(-last, last + 1)) % len(boundary.points)]
    length = float(np.linalg.norm(armpit - shoulder))
    if length < 4 * _MARGIN:
        return None
    curves, normals = _curves(ends, armpit, length)
    darkness, on_cloth = _darkness(picture, curves, normals)
    evidence, dark_share = _evidence(darkness, on_cloth, _PART * length)
    curve = np.argmax(evidence, axis=1)
    by_end = evidence[np.arange(len(ends)), curve]
    best = int(np.argmax(by_end))
    elsewhere = np.abs(np.arange(len(ends)) - best) * step > _ELSEWHERE
    at_limit = min(best, len(ends) - 1 - best) * step < 0.05 * _SEARCH
    if at_limit or by_end[best] < _EVIDENCE or dark_share[best, curve[best]] < _COMPLETE:
        return None
    if by_end[elsewhere].max() > _RIVAL * by_end[best]:
        return None
    return np.asarray(ends[best].copy())


def _curves(ends: Array, armpit: Array, length: float) -> tuple[Array, Array]:
    """Parabolas (n, bows, samples, 2) from the points `ends` (n, 2) towards the armpit, and their unit normals."""
    chord = armpit - ends
    across = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / np.linalg.norm(chord, axis=1, keepdims=True)
    bows = np.linspace(-_BOW, _BOW, _BOWS)
    t = np.linspace(_MARGIN / length, _PART, _SAMPLES)
    along, aside = chord[:, None, None], across[:, None, None]
    curves = ends[:, None, None] + t[:, None] * along + (4 * bows[:, None] * t * (1 - t))[..., None] * aside
    tangents = along + (4 * bows[:, None] * (1 - 2 * t))[..., None] * aside
    tangents = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
    return curves, np.stack([-tangents[..., 1], tangents[..., 0]], axis=-1)


def _darkness(picture: ClothPicture, curves: Array, normals: Array) -> tuple[Array, NDArray[np.bool_]]:
    """How much darker each point of the curves is than the points on both sides [grey levels], and whether all
    three show the garment."""
    shape = curves.shape[:-1]
    pixels = [picture.pixels((curves + side * _BESIDE * normals).reshape(shape[0], -1, 2)) for side in (-1, 0, 1)]
    low = np.maximum(np.floor(np.min([p.min(axis=(0, 1)) for p in pixels], axis=0)).astype(int) - 3, 0)
    high = np.ceil(np.max([p.max(axis=(0, 1)) for p in pixels], axis=0)).astype(int) + 4
    window = slice(low[1], high[1]), slice(low[0], high[0])
    bright = cv2.GaussianBlur(picture.rgb[window].mean(axis=2, dtype=np.float32), (0, 0), 0.7)
    cloth = cv2.erode(picture.mask[window].astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    offset = low.astype(np.float32)
    left, middle, right = (sample(bright, p - offset) for p in pixels)
    on_cloth = np.min([sample(cloth, p - offset) for p in pixels], axis=0) > 0.99
    return (0.5 * (left + right) - middle).reshape(shape), on_cloth.reshape(shape)


def _evidence(darkness: Array, on_cloth: NDArray[np.bool_], length: float) -> tuple[Array, Array]:
    """Evidence (n, bows) for a seam along each curve, and the share (n, bows) of dark points."""
    seen = darkness[on_cloth]
    if not len(seen):
        return np.zeros(darkness.shape[:2]), np.zeros(darkness.shape[:2])
    spread = 1.4826 * float(np.median(np.abs(seen - np.median(seen)))) + _NOISE
    relative = np.where(on_cloth, np.clip(darkness / spread, -3.0, 3.0), 0.0)
    count = np.maximum(np.count_nonzero(on_cloth, axis=2), 1)
    mean = relative.sum(axis=2) / count
    enough = count > 0.6 * darkness.shape[2]
    evidence = np.where(enough & (mean > 0), count / darkness.shape[2] * length / 0.016 * mean**2, 0.0)
    return evidence, np.count_nonzero(relative > 0.8, axis=2) / count
