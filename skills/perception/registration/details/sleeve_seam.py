"""Locates the shoulders of a shirt at the upper ends of the seams between its sleeves and the body, which run from
there to the armpits.

The outline of a shirt hardly bends at a shoulder, but in many pictures the seam is visible as a dark line.
Curves from each place of the outline near the shoulder to the armpit, with several curvatures, are compared with
the picture: along the seam, the points are darker than those on both sides of it. A pattern can have dark lines,
too. Therefore the lines are weighed against the place where the outline puts the shoulder, and against those on
the other side, because halves are alike. The spread of the posterior is the uncertainty: it stays wide where no
line, or more than one, looks like a seam.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import polygon_area
from foldcell.skills.perception.registration.boundary import sample
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.energy import Boundary

_BOW = 0.024  # maximum sagitta of a seam [m]
_BESIDE = 0.005  # distance of the points with which a point of the seam is compared [m]
_MARGIN = 0.008  # distance from the outline at which a seam is looked for [m]
_PART = 0.8  # share of the seam's length, from the shoulder, that is compared: the armpit is not known exactly
_NOISE = 0.5  # standard deviation of the noise of a pixel's brightness [grey levels]
_EVEN, _SLOPE = 25.0, 0.2
"""Evidence at which a line is as likely a seam as not, and by how much the logarithm of the odds grows per
evidence. The evidence is the squared darkness of the line, relative to the variation of the cloth, times its
length in units of 16 mm."""
_ASIDE = (-0.2, 0.2, 0.3, 0.4)
"""Displacements of a seam to where the cloth has none, relative to the distance of the armpits. On checked and
striped cloth, lines there have as much evidence; a seam has more than most of them."""
_SPARSE = 3
"""One in so many displaced lines is enough: a dark line is wider than the places of the outline are apart."""
_RANGE = 3.0
"""Seams are looked for up to so many standard deviations from where the outline puts the shoulder."""
_ALIKE = (0.02, 0.04)
"""Standard deviations of the difference between the places of the shoulders, seen from the armpits, along the axis
and across, relative to the square root of the garment's area."""
_SEAM_SIGMA = 0.0016
"""Standard deviation of the end of a seam [m]."""
_SAMPLES, _BOWS = 36, 13
"""Number of points on a curve, and number of curves of different curvature that end at one point of the
boundary."""


def locate_seams(
    picture: ClothPicture, boundary: Boundary, shoulders: Sequence[tuple[Array, float]], armpits: Array, up: Array
) -> list[tuple[Array, float]]:
    """Return the places (2,) of both shoulders on the boundary, with their standard deviations [m].

    shoulders: the same by the outline alone. armpits: (2, 2) [m]. up: (2,) unit vector from hem to collar.
    """
    size = float(np.sqrt(abs(polygon_area(boundary.points))))
    ends, away, seen, elsewhere = [], [], [], []
    for (place, sigma), armpit, across in zip(shoulders, armpits, armpits[::-1] - armpits, strict=True):
        at, apart = _near(boundary, place, _RANGE * sigma)
        length = float(np.linalg.norm(armpit - place))
        seen.append((_evidence(picture, at, armpit, length), 0.5 * (apart / sigma) ** 2))
        for aside in _ASIDE:
            moved = at[::_SPARSE] + aside * across
            elsewhere.append(_evidence(picture, moved, armpit + aside * across, length).max())
        ends.append(at)
        away.append((at - armpit) @ np.column_stack([up, (-up[1], up[0])]) / size)
    even = max(_EVEN, float(np.quantile(elsewhere, 0.75)))
    log_p = [np.logaddexp(0.0, _SLOPE * (evidence - even)) - far for evidence, far in seen]
    unlike = (away[0][:, None] - away[1] * (1.0, -1.0)) / _ALIKE
    joint = log_p[0][:, None] + log_p[1] - 0.5 * (unlike**2).sum(axis=2)
    p = np.exp(joint - joint.max())
    return [_moments(at, share) for at, share in zip(ends, (p.sum(axis=1), p.sum(axis=0)), strict=True)]


def _near(boundary: Boundary, place: Array, reach: float) -> tuple[Array, Array]:
    """Return the points (n, 2) of the boundary around a place (2,), and their distances (n,) along it [m]."""
    step = boundary.length / len(boundary.points)
    k = np.arange(-int(reach / step) - 1, int(reach / step) + 2)
    at = (int(boundary.nearest(place[None])[1][0]) + k) % len(boundary.points)
    return boundary.points[at], np.asarray(step * k, dtype=np.float64)


def _moments(at: Array, share: Array) -> tuple[Array, float]:
    """Return the point nearest to the mean of points (n, 2) with weights (n,), and their standard deviation."""
    share = share / share.sum()
    mean = share @ at
    spread = float(np.sqrt(share @ ((at - mean) ** 2).sum(axis=1)))
    return at[int(np.argmin(np.linalg.norm(at - mean, axis=1)))].copy(), float(np.hypot(spread, _SEAM_SIGMA))


def _evidence(picture: ClothPicture, ends: Array, armpit: Array, length: float) -> Array:
    """Return the evidence (n,) for a seam of this length [m] that runs from each of the ends (n, 2) to the
    armpit (2,)."""
    if length < 4 * _MARGIN:
        return np.zeros(len(ends))
    darkness, on_cloth = _darkness(picture, *_curves(ends, armpit, length))
    seen = darkness[on_cloth]
    if not len(seen):
        return np.zeros(len(ends))
    spread = 1.4826 * float(np.median(np.abs(seen - np.median(seen)))) + _NOISE
    relative = np.where(on_cloth, np.clip(darkness / spread, -3.0, 3.0), 0.0)
    count = np.count_nonzero(on_cloth, axis=2)
    mean = np.maximum(relative.sum(axis=2) / np.maximum(count, 1), 0.0)
    share = count / darkness.shape[2]
    return np.asarray(np.where(share > 0.6, share * _PART * length / 0.016 * mean**2, 0.0).max(axis=1))


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
    low = np.floor(np.min([p.min(axis=(0, 1)) for p in pixels], axis=0)).astype(int) - 3
    high = np.ceil(np.max([p.max(axis=(0, 1)) for p in pixels], axis=0)).astype(int) + 4
    # A displaced seam may lie beside the picture. The window then holds the nearest pixels.
    low, high = np.clip(low, 0, np.array(picture.mask.shape[::-1]) - 1), np.maximum(high, 1)
    window = slice(low[1], high[1]), slice(low[0], high[0])
    bright = cv2.GaussianBlur(picture.rgb[window].mean(axis=2, dtype=np.float32), (0, 0), 0.7)
    cloth = cv2.erode(picture.mask[window].astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    offset = low.astype(np.float32)
    left, middle, right = (sample(bright, p - offset) for p in pixels)
    on_cloth = np.min([sample(cloth, p - offset) for p in pixels], axis=0) > 0.99
    return (0.5 * (left + right) - middle).reshape(shape), on_cloth.reshape(shape)
