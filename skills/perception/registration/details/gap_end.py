"""Locates the end of the gap between two pieces of cloth in the picture: a crotch, or an armpit.

Near its end the gap is narrower than the resolution of a segmentation. The segmented boundary therefore ends some
centimetres before the end of a crotch, and up to two centimetres before that of an armpit. In the picture the gap
can be followed further, because a narrow gap is a faint line. A wedge (`wedge`) is fitted to the picture; its tip
is the key point.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.wedge import Strip, Wedge, WedgePrior, fit_wedge


@dataclass(frozen=True)
class GapSettings:
    """What differs between the kinds of gaps. Lengths [m], for a garment of its nominal size.

    beyond: the gap is followed this far beyond the first guess into the garment. step: distance between rows of
    pixels. across: distance between the pixels of a row. side: half the width of a row. border: pixels further
    than this from the middle of a row show cloth. wide, tip: the wedge is fitted first up to the distance `wide`
    after the place where the gap is wide, and then up to the distance `tip` from its tip. misfit: maximum
    difference of model and picture (root mean square), relative to the contrast. growth_log, curvature: see
    `WedgePrior`. round: radius of the rounding of the sewn end. starts: number of start values of the fit.
    """

    beyond: float
    step: float
    across: float
    side: float
    border: float
    wide: float
    tip: float
    misfit: float
    growth_log: float
    curvature: float
    round: float
    starts: int


NARROW = GapSettings(
    beyond=0.08, step=0.0025, across=0.00125, side=0.024, border=0.014, wide=0.04, tip=0.045, misfit=0.50,
    growth_log=0.7, curvature=0.3, round=0.002, starts=2,
)  # fmt: skip
"""For the gap between two legs."""
HOLLOW = GapSettings(
    beyond=0.05, step=0.002, across=0.002, side=0.036, border=0.022, wide=0.02, tip=0.025, misfit=0.60,
    growth_log=0.2, curvature=2.0, round=0.008, starts=1,
)  # fmt: skip
"""For the corner between a sleeve and the body."""

_CONTRAST, _FAINT = 1.9, 10.0
"""Minimum difference between the colours of cloth and table, in standard deviations of the pattern and in grey
levels."""
_NOISE = 2.0
"""Standard deviation of the noise of a pixel's colour [grey levels]."""
_FAIR = 0.15
"""If the misfit is larger than this, the uncertainty grows with it."""
_PLACE_SIGMA = 0.020
"""Standard deviation of the first guess along the gap [m]."""
_WIDTH_SIGMA = 0.0005
"""Standard deviation of the gap's width, because cloth that nearly touches hides the end [m]."""
_TIP_SIGMA = 0.0020
"""Least standard deviation of the place of a tip [m]."""
_DOUBT = 1.5
"""Ratio of the real errors to the errors that follow from the curvature of the cost alone."""


def locate_gap_end(
    picture: ClothPicture,
    guess: Array,
    opening: Array,
    growth: float,
    settings: GapSettings = NARROW,
    size: float = 1.0,
) -> tuple[Array, float] | None:
    """Find the end of the gap that runs from `opening` (2,) towards `guess` (2,) [m].

    Return its place (2,) and the standard deviation of the place [m]; None if the picture does not show it: the
    pieces of cloth touch, or cloth and table look alike.

    growth: expected growth of the gap's width per length. size: size of the garment, relative to the nominal size.
    """
    length = float(np.linalg.norm(opening - guess)) / size
    if not length > settings.side:
        return None
    along = (opening - guess) / (length * size)
    across = np.array([-along[1], along[0]])
    s = np.arange(-settings.beyond, min(0.8 * length, 0.30), settings.step)
    v = np.arange(-settings.side, settings.side + 1e-9, settings.across)
    points = guess + size * (s[:, None, None] * along + v[None, :, None] * across)
    cloth = picture.cloth(points)
    gap, core = _segmented(cloth, settings)
    if np.count_nonzero(core) < 15:
        return None
    first = int(np.flatnonzero(core.any(axis=1))[0])
    core[first + round(0.03 / settings.step) :] = False
    strip = _strip(s, v, picture.colours(points), cloth, core, settings)
    line = _middle_line(s, v, gap, first, settings)
    if strip is None or line is None or s[first] < s[0] + 0.015:
        return None  # the gap is wide as far as it is followed
    wedge = _fit(strip, float(s[first]), line, growth, settings)
    if wedge is None or wedge.misfit > settings.misfit or not s[0] + 0.005 < wedge.parameters[0] < s[first]:
        return None
    p = wedge.parameters
    place = guess + size * (p[0] * along + p[1] * across)
    by_fit = _DOUBT * max(1.0, wedge.misfit / _FAIR) * np.sqrt(wedge.covariance[0, 0])
    sigma = np.linalg.norm([by_fit, _WIDTH_SIGMA / p[3], _TIP_SIGMA])
    return np.asarray(place), float(size * sigma)


def _segmented(cloth: Array, settings: GapSettings) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks (n, m): where the segmentation sees the gap, and where this gap is wide enough to show the
    table's own colour."""
    is_cloth = cloth > 0.5
    between = np.maximum.accumulate(is_cloth, axis=1) & np.maximum.accumulate(is_cloth[:, ::-1], axis=1)[:, ::-1]
    gap = ~is_cloth & between
    reach = 2 * round(0.00125 / settings.across) + 1
    return gap, gap & (cv2.erode((cloth < 0.05).astype(np.uint8), np.ones((1, reach), np.uint8)) > 0)


def _strip(
    s: Array, v: Array, colour: Array, cloth: Array, core: NDArray[np.bool_], settings: GapSettings
) -> Strip | None:
    """Whiten the colours (n, m, 3). Rows without cloth beside them become NaN. None without enough contrast."""
    table = np.median(colour[core], axis=0)
    beside = (np.abs(v) >= settings.border) & (cloth > 0.95)
    seen = np.count_nonzero(beside, axis=1) >= 8
    if not seen.any():
        return None
    legs = np.full((len(s), 3), np.nan)
    legs[seen] = np.nanmedian(np.where(beside[seen, :, None], colour[seen], np.nan), axis=1)
    pattern = (colour - legs[:, None])[beside & seen[:, None]]
    scatter = pattern.T @ pattern / len(pattern) + _NOISE**2 * np.eye(3)
    whiten = np.linalg.inv(np.linalg.cholesky(scatter))
    contrast = np.linalg.norm((table - legs) @ whiten.T, axis=1)
    usual = float(np.nanmedian(contrast))
    faint = np.nanmedian(np.linalg.norm(table - legs, axis=1)) < _FAINT
    if faint or usual < _CONTRAST:
        return None
    whiten = whiten / usual
    legs[~(contrast > 0.3 * usual)] = np.nan
    whitened = (colour - legs[:, None]) @ whiten.T
    size = np.linalg.norm(whitened, axis=2, keepdims=True)
    whitened = whitened * np.minimum(1.0, 1.5 / np.maximum(size, 1e-9))
    return Strip(s, v, whitened, whiten @ table, legs @ whiten.T, settings.round)


def _middle_line(
    s: Array, v: Array, gap: NDArray[np.bool_], first: int, settings: GapSettings
) -> tuple[float, float, float] | None:
    """Fit a straight gap to the segmentation: place of its middle line at s = 0, slope of this line, and growth of
    the gap's width; None if the segmentation shows too little of it."""
    rows = np.flatnonzero(gap.any(axis=1) & (s < s[first] + 2.0 * settings.wide))
    if len(rows) < 6:
        return None
    middle = np.array([v[gap[i]].mean() for i in rows])
    width = np.count_nonzero(gap[rows], axis=1) * (v[1] - v[0])
    slope, place = np.polyfit(s[rows], middle, 1)
    return float(place), float(slope), max(float(np.polyfit(s[rows], width, 1)[0]), 0.03)


def _fit(
    strip: Strip, wide: float, line: tuple[float, float, float], growth: float, settings: GapSettings
) -> Wedge | None:
    """Fit the wedge up to a distance from where it is wide, and again near its tip, where the edges are
    straight."""
    prior = WedgePrior(_PLACE_SIGMA, growth, settings.growth_log, settings.curvature)
    seen = np.isfinite(strip.cloth[:, 0])
    used = seen & (strip.s < wide + settings.wide)
    if np.count_nonzero(used) < 8:
        return None
    middle, slope, opened = line
    starts = [
        np.array([s0, middle + slope * s0, slope, opened, 0.3, 0.0018, 0.0])
        for s0 in np.arange(strip.s[0] + 0.01, wide, 0.01)
    ]
    wedge = fit_wedge(strip.rows(used), starts, prior, settings.starts)
    used = seen & (np.abs(strip.s - wedge.parameters[0]) < settings.tip)
    if np.count_nonzero(used) < 8:
        return None
    return fit_wedge(strip.rows(used), [wedge.parameters], prior, 1)
