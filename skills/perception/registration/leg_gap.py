"""Locates the end of the gap between two legs, the crotch, in the picture.

Near the crotch the gap is narrower than what a segmentation resolves, so that the segmented boundary ends
centimetres before it. In the picture the gap can be followed further: a narrow gap is a faint line. The gap is
modelled as a wedge with straight edges. In cross-section, the share of the table's colour in a pixel is that of a
strip of width w = k (s - s0), s being the distance along the gap, blurred by the camera. In a narrow gap, the legs
darken the table. The wedge is fitted to the pixels by robust nonlinear least squares; its tip is the key point.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from robots.ports import Array
from skills.perception.registration.cloth_picture import ClothPicture, sample

_LOW = np.array([-0.1, -0.05, -1.0, 0.02, -0.5, 0.001])
_HIGH = np.array([0.2, 0.05, 1.0, 1.5, 1.0, 0.0035])
"""Bounds of the wedge's parameters."""
_STEPS = 25

__all__ = ["GapEnd", "GapSettings", "locate_gap_end"]


@dataclass(frozen=True)
class GapSettings:
    """Lengths [m].

    beyond: the gap is followed this far beyond the first guess into the garment. step: distance of the rows of
    pixels that are looked at; side: half their width. border: pixels further than this from the middle of a row
    show cloth. wide: the wedge is fitted first up to this distance after the place where the gap is wide; tip:
    and at last up to this distance from its tip. shade: width of a gap in which the shade of the legs fades.
    contrast: minimum difference of cloth and table, and noise: of a pixel's colour [grey levels]. misfit: maximum
    difference of model and picture (root mean square), relative to the contrast. width_sigma: standard deviation
    of the width of the gap; side_sigma: of the place of its middle line.
    """

    beyond: float = 0.08
    tip: float = 0.06
    step: float = 0.0025
    side: float = 0.024
    border: float = 0.014
    wide: float = 0.04
    shade: float = 0.008
    contrast: float = 22.0
    noise: float = 5.0
    misfit: float = 0.30
    width_sigma: float = 0.0008
    side_sigma: float = 0.0015


@dataclass(frozen=True, eq=False)
class GapEnd:
    """place: (2,) [m]. covariance: (2, 2) [m2]."""

    place: Array
    covariance: Array


def locate_gap_end(
    picture: ClothPicture, guess: Array, opening: Array, settings: GapSettings | None = None
) -> GapEnd | None:
    """Find the end of the gap that runs from `opening` (2,) towards `guess` (2,) [m]. None if the picture does not
    show it: the legs touch, or cloth and table look alike."""
    settings = settings or GapSettings()
    length = float(np.linalg.norm(opening - guess))
    if not length > settings.side:
        return None
    along = (opening - guess) / length
    across = np.array([-along[1], along[0]])
    s = np.arange(-settings.beyond, 0.8 * length, settings.step)
    v = np.arange(-settings.side, settings.side + 1e-9, 0.5 * settings.step)
    strip = guess + s[:, None, None] * along + v[None, :, None] * across
    share = _table_share(picture, strip, v, settings)
    if share is None:
        return None
    opacity, gap, first = share
    start = _start(s, v, gap, first)
    seen = np.isfinite(opacity[:, 0])
    used = seen & (s < s[first] + settings.wide)
    if start is None or s[first] < s[0] + 0.015 or np.count_nonzero(used) < 8:
        return None  # the gap is wide as far as it is followed
    starts = [
        np.array([s0, start[0] + start[1] * s0, start[1], start[2], 0.3, 0.0018])
        for s0 in np.arange(s[0] + 0.01, s[first], 0.01)
    ]
    fitted, misfit = _fit(s[used], v, opacity[used], starts, settings)
    used = seen & (np.abs(s - fitted[0]) < settings.tip)  # the edges are straight near the tip only
    if np.count_nonzero(used) < 8:
        return None
    fitted, misfit = _fit(s[used], v, opacity[used], [fitted], settings)
    if misfit > settings.misfit or not s[0] + 0.005 < fitted[0] < s[first]:
        return None
    tip = guess + fitted[0] * along + fitted[1] * across
    return GapEnd(tip, _covariance(along + fitted[2] * across, float(fitted[3]), misfit, settings))


def _table_share(
    picture: ClothPicture, strip: Array, v: Array, settings: GapSettings
) -> tuple[Array, NDArray[np.bool_], int] | None:
    """Compute the share (n, m) of the table's colour at the points `strip` (n, m, 2), NaN where the cloth beside
    the gap is not seen; (n, m), where the segmentation sees the gap; and the first row where the gap is wide.

    The colours are projected onto the direction that separates the table best from a patterned cloth (Fisher's
    linear discriminant).
    """
    pixels = picture.pixels(strip)
    colour, cloth = sample(picture.rgb, pixels), sample(picture.mask.astype(np.float32), pixels)
    is_cloth = cloth > 0.5
    between = np.maximum.accumulate(is_cloth, axis=1) & np.maximum.accumulate(is_cloth[:, ::-1], axis=1)[:, ::-1]
    gap = ~is_cloth & between
    core = gap & (cv2.erode((cloth < 0.05).astype(np.uint8), np.ones((1, 3), np.uint8)) > 0)
    if np.count_nonzero(core) < 20:
        return None
    first = int(np.flatnonzero(core.any(axis=1))[0])
    core[first + 12 :] = False
    table = np.median(colour[core], axis=0)
    beside = (np.abs(v) >= settings.border) & (cloth > 0.95)
    seen = np.count_nonzero(beside, axis=1) >= 8
    legs = np.full((len(gap), 3), np.nan)
    legs[seen] = np.nanmedian(np.where(beside[seen, :, None], colour[seen], np.nan), axis=1)
    difference = table - legs
    if not seen.any() or np.nanmedian(np.linalg.norm(difference, axis=1)) < settings.contrast:
        return None
    pattern = (colour - legs[:, None])[beside & seen[:, None]]
    scatter = pattern.T @ pattern / len(pattern) + settings.noise**2 * np.eye(3)
    direction = np.linalg.solve(scatter, np.nanmedian(difference, axis=0))
    contrast = difference @ direction
    contrast = np.where(contrast > 0.3 * np.nanmedian(contrast), contrast, np.nan)
    share = (colour - legs[:, None]) @ direction / contrast[:, None]
    share = np.clip(share, -0.5, 1.5)
    return share, gap, first


def _start(s: Array, v: Array, gap: NDArray[np.bool_], first: int) -> tuple[float, float, float] | None:
    """Fit a straight gap to the segmentation: place of its middle line at s = 0, slope of this line, and growth of
    the gap's width; None if the segmentation shows too little of it."""
    rows = np.flatnonzero(gap.any(axis=1) & (s < s[first] + 0.08))
    if len(rows) < 6:
        return None
    middle = np.array([v[gap[i]].mean() for i in rows])
    width = np.count_nonzero(gap[rows], axis=1) * (v[1] - v[0])
    slope, place = np.polyfit(s[rows], middle, 1)
    return float(place), float(slope), max(float(np.polyfit(s[rows], width, 1)[0]), 0.03)


def _fit(s: Array, v: Array, share: Array, starts: list[Array], settings: GapSettings) -> tuple[Array, float]:
    """Fit the wedge to the table's share (n, m) at the places s (n,) and v (m,). Returns its parameters (place s0
    and v0 of its tip, slope of its middle line, growth of its width, shade, blur), and the misfit."""

    best = min(
        starts, key=lambda p: float(np.minimum((_wedge(p, s, v, settings.shade)[0] - share) ** 2, 0.1).sum())
    )
    p, damping = np.clip(best, _LOW, _HIGH), 1e-2
    r, J, cost = _residual(p, s, v, share, settings)
    for _ in range(_STEPS):
        A, g = np.einsum("ki,kj->ij", J, J), np.einsum("ki,k->i", J, r)  # not @: BLAS would use threads
        candidate = np.clip(p - np.linalg.solve(A + damping * np.diag(A.diagonal() + 1e-9), g), _LOW, _HIGH)
        next_r, next_J, next_cost = _residual(candidate, s, v, share, settings)
        if next_cost >= cost:
            damping *= 5.0
            continue
        settled = cost - next_cost < 1e-4 * cost
        p, r, J, cost, damping = candidate, next_r, next_J, next_cost, 0.3 * damping
        if settled:
            break
    near = np.abs(v - (p[1] + p[2] * (s - p[0]))[:, None]) < 0.008
    return p, float(np.sqrt(np.mean((_wedge(p, s, v, settings.shade)[0] - share)[near] ** 2)))


def _residual(p: Array, s: Array, v: Array, share: Array, settings: GapSettings) -> tuple[Array, Array, float]:
    """Weighted residuals (k,), their Jacobian (k, 6) and the cost. The loss is 2 (sqrt(1 + r^2) - 1), the unit of
    r being a tenth of the contrast."""
    model, jacobian = _wedge(p, s, v, settings.shade)
    r = (model - share).ravel() / 0.1
    root = np.sqrt(1.0 + r**2)
    weight = 1.0 / np.sqrt(root)
    return r * weight, jacobian.reshape(-1, 6) * (weight / 0.1)[:, None], float((2.0 * (root - 1.0)).sum())


def _wedge(p: Array, s: Array, v: Array, shade_width: float) -> tuple[Array, Array]:
    """The table's share (n, m) according to the parameters `p` (6,), see `_fit`, and its derivatives (n, m, 6)."""
    width = p[3] * np.maximum(s - p[0], 0.0)[:, None]
    away = v - (p[1] + p[2] * (s - p[0]))[:, None]
    upper, lower = (away + 0.5 * width) / p[5], (away - 0.5 * width) / p[5]
    covered = ndtr(upper) - ndtr(lower)
    fading = np.exp(-width / shade_width)
    light = 1.0 - p[4] * fading
    on_upper, on_lower = (np.exp(-0.5 * z**2) * light / np.sqrt(2 * np.pi) / p[5] for z in (upper, lower))
    by_place = on_upper - on_lower
    by_width = 0.5 * (on_upper + on_lower) + covered * p[4] * fading / shade_width
    is_open = (s > p[0])[:, None]
    jacobian = np.stack([
        by_place * p[2] - by_width * p[3] * is_open, -by_place, -by_place * (s - p[0])[:, None],
        by_width * np.maximum(s - p[0], 0.0)[:, None], -covered * fading, -(on_upper * upper - on_lower * lower),
    ], axis=-1)  # fmt: skip
    return covered * light, jacobian


def _covariance(direction: Array, growth: float, misfit: float, settings: GapSettings) -> Array:
    """The wedge's edges are known to `width_sigma`, so a narrow wedge's tip is uncertain along the gap."""
    along = direction / np.linalg.norm(direction)
    across = np.array([-along[1], along[0]])
    worse = max(1.0, misfit / 0.1)
    sigma_along, sigma_across = worse * settings.width_sigma / growth, worse * settings.side_sigma
    return np.asarray(sigma_along**2 * np.outer(along, along) + sigma_across**2 * np.outer(across, across))
