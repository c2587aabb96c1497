"""Locates the shoulders and the ends of the collar of a shirt whose shape is not known beforehand.

The outline hardly bends at a shoulder, and a rounded collar has no corner. Taken one by one, these key points can
lie anywhere on a smooth line. Taken together they can not: both halves of the upper edge are alike, the collar is
a dip or stands up between two slopes, and beyond the shoulders the edge falls more steeply. So one model is fitted
to the whole upper edge: height over distance from the axis, with knots at the collar's ends and the shoulders. For
each place of the knots, the other coefficients are integrated out, as in `bend`. Its product with the usual
proportions of shirts is the posterior. Its spread is the uncertainty: where an edge is smooth, it is wide.

A collar ends where it meets the shoulder's seam. A collar that stands up reaches beyond its ends. Where the
picture shows the neckline (`neckline`), its axis and width replace the usual ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import polygon_area
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.neckline import locate_neckline
from foldcell.skills.perception.registration.energy import Boundary

# Lengths are relative to the square root of the garment's area.
_STEP = 0.008
"""Distance of the boundary's points."""
_NOISE, _CORRELATION = 0.0025, 0.03
"""Standard deviation of these points from the model, and the length over which it is correlated."""
_FREEDOM = 8.0
"""Degrees of freedom of the t-distribution that replaces the normal one: outlines have wrinkles."""
_AXIS, _COLLAR, _SHOULDER = (-0.04, 0.041, 0.02), (0.08, 0.30, 0.02), (0.25, 0.70, 0.024)
"""Places of the axis, the collar's end and the shoulder that are tried first: from, to, step."""
_FINER = ((-0.016, 0.017, 0.008), (-0.015, 0.016, 0.005), (-0.018, 0.019, 0.006))
"""Displacements from the best of them that are tried then."""
_STAND = 0.03
"""Width of the side of a standing collar."""
_LABEL = 0.10
"""Width of a label at the neck, at most. Its colour differs from the cloth's, and the segmentation often leaves it
out."""
_STEEP = 1.9
"""Beyond the shoulders, the edge is followed as far as its slope is below this."""
_MEAN = np.array([0.0, 0.0, -0.36, 0.0, -0.70, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
_SIGMA = np.array([9.0, 0.15, 0.12, 0.08, 0.45, 0.15, 1.0, 2.5, 1.0, 0.025, 0.01])
"""Mean and standard deviation of the coefficients: height and tilt; slopes of shoulder and sleeve, each with half
of the difference between the sides; curvatures; depth or height of the collar, and its curvature."""
_DIP, _STANDING = (-0.03, 0.025), (0.06, 0.02)
"""Mean and standard deviation of the height of the collar's middle above its ends: a neckline, one that stands."""
_RISE, _WIDTH, _DROOP, _NECK, _OFFSET = (0.815, 0.04), (0.67, 0.11), 0.38, (0.42, 0.07), 0.03
"""Proportions of shirts, with standard deviations: height of the shoulder above the armpits, relative to that of
the collar's ends; its distance from the axis, relative to that of the armpits, with its increase per angle by
which the sleeve droops [1/rad], because a sleeve that hangs down covers the body's side; distance of the collar's
ends from the axis, relative to that of the shoulders; the axis's distance from the middle of the armpits."""
_NECKLINE = 0.02
"""Standard deviation of axis and half width of a neckline that the picture shows."""
_LEAST_SIGMA = (0.022, 0.050)
"""Least standard deviation of the places found, collar and shoulder: halves differ, and proportions do. They
follow from the errors of 25 shirts of the real set (`benchmarks.photographs`)."""


@dataclass(frozen=True, eq=False)
class _Edge:
    """An upper edge in the frame of the body, at unit area. y: (n,) height. b: (n,) to the first side. armpit:
    their mean height. half: their distance from the axis. cuff: (2,) mean height of the upper ends of the cuffs,
    and their distance from the axis. middle: place of the axis between them. neckline: its axis
    and half width, if it is visible. seams: axis, half width and standard deviation of the shoulders, if they are
    known."""

    y: Array
    b: Array
    armpit: float
    half: float
    cuff: Array
    middle: float
    neckline: tuple[float, float] | None
    seams: tuple[float, float, float] | None


def locate_upper_edge(
    keypoints: Mapping[str, Array],
    contour: Array,
    sides: tuple[str, str],
    picture: ClothPicture | None = None,
    shoulders: Sequence[tuple[Array, float]] = (),
) -> Mapping[str, tuple[Array, float]]:
    """Return the place (2,) and its standard deviation [m] for the shoulders and the ends of the collar;
    of none if the edge is too short for a shirt.

    keypoints: name -> (2,) [m], of which hem, armpits and cuffs are used. contour: (n, 2) observed boundary,
    counter-clockwise [m]. sides: their names in this order. picture: may show the neckline. shoulders: their
    places (2,) and standard deviations [m], if their seams show them.
    """
    size = float(np.sqrt(abs(polygon_area(contour))))
    hem, armpit, cuff = (np.array([keypoints[f"{n}_{s}"] for s in sides]) for n in ("hem", "armpit", "cuff_upper"))
    up, across = armpit.mean(axis=0) - hem.mean(axis=0), (armpit + hem)[0] - (armpit + hem)[1]
    frame = size * np.column_stack([up / np.linalg.norm(up), across / np.linalg.norm(across)])
    to_frame = np.linalg.inv(frame).T
    boundary = Boundary(contour, step=_STEP * size)
    first, last = boundary.nearest(cuff)[1]
    n = len(boundary.points)
    chain = boundary.points[(first + np.arange((last - first) % n + 1)) % n]
    chain = _over_body(chain, (chain - hem.mean(axis=0)) @ to_frame, (armpit - hem.mean(axis=0)) @ to_frame)
    pits = (armpit - hem.mean(axis=0)) @ to_frame
    y, b = ((chain - hem.mean(axis=0)) @ to_frame).T
    y_closed, middle = _closed(y, b), float(pits[:, 1].mean())
    neckline = None
    if picture is not None:
        neckline = locate_neckline(picture, np.stack([y_closed, b], 1), frame, hem.mean(axis=0), middle)
    half = 0.5 * float(pits[0, 1] - pits[1, 1])
    cuffs = (cuff - hem.mean(axis=0)) @ to_frame
    ends = np.array([cuffs[:, 0].mean(), 0.5 * (cuffs[0, 1] - cuffs[1, 1])])
    seams = None
    if shoulders:
        first, second = (float(((place - hem.mean(axis=0)) @ to_frame)[1]) for place, _ in shoulders)
        spread = np.linalg.norm([_NECKLINE, *(sigma / size for _, sigma in shoulders)])
        seams = 0.5 * (first + second), 0.5 * (first - second), float(spread)
    edge = _Edge(y_closed, b, float(pits[:, 0].mean()), half, ends, middle, neckline, seams)
    found = _knots(edge)
    if found is None:
        return {}
    heights, places, sigmas = found
    located = {}
    for row, name in enumerate(("collar", "shoulder")):
        for k, side in enumerate(sides):
            at = np.array([heights[row, k], places[row, k]])
            nearest = int(np.argmin(np.linalg.norm(np.column_stack([y, b]) - at, axis=1)))
            located[f"{name}_{side}"] = chain[nearest], size * float(np.hypot(sigmas[row], _LEAST_SIGMA[row]))
    return located


def _closed(y: Array, b: Array) -> Array:
    """Return the heights (n,) of an edge at the places b (n,) without notches narrower than `_LABEL`
    (morphological closing). The last points at both ends stay, because nothing is known beyond them."""
    near = np.abs(b - b[:, None]) <= 0.5 * _LABEL
    highest = np.where(near, y, -np.inf).max(axis=1)
    closed = np.where(near, highest, np.inf).min(axis=1)
    inner = (b > b.min() + _LABEL) & (b < b.max() - _LABEL)
    return np.where(inner, closed, y)


def _over_body(chain: Array, framed: Array, pits: Array) -> Array:
    """Return the part of the chain (n, 2) between the places beyond the shoulders where it becomes steep."""
    half, middle = 0.5 * (pits[0, 1] - pits[1, 1]), pits[:, 1].mean()
    kernel = np.ones(7) / 7
    dy, db = (np.convolve(np.pad(d, 3, mode="edge"), kernel, "valid") for d in np.gradient(framed, axis=0).T)
    out = np.abs(framed[:, 1] - middle)
    ends = np.flatnonzero((out > 1.5 * half) | ((out > 0.75 * half) & (np.abs(dy) > _STEEP * np.abs(db))))
    top = int(np.argmin(out + 9.0 * (framed[:, 0] < pits[:, 0].mean())))
    before, after = ends[ends < top], ends[ends > top]
    return chain[before[-1] + 1 if len(before) else 0 : after[0] if len(after) else len(chain)]


def _knots(edge: _Edge) -> tuple[Array, Array, Array] | None:
    """Return heights and places (2, 2) of the knots, those of the collar first, and standard deviations (2,) of
    their distances from the axis along the edge."""
    reach = min(edge.b.max() - edge.middle, edge.middle - edge.b.min())
    axis, collar, shoulder = (np.arange(*span) for span in (_AXIS, _COLLAR, _SHOULDER))
    axis += edge.middle if edge.neckline is None else edge.neckline[0]
    tried = np.stack(np.meshgrid(axis, collar, shoulder, indexing="ij"), axis=-1).reshape(-1, 3)
    tried = tried[(tried[:, 2] > tried[:, 1] + 0.05) & (tried[:, 2] < reach - 0.02)]
    if not len(tried):
        return None
    both = [_posterior(edge, tried, standing) for standing in (False, True)]
    standing = bool(both[1][0].max() > both[0][0].max())
    log_p = both[standing][0]
    finer = np.stack(np.meshgrid(*(np.arange(*s) for s in _FINER), indexing="ij"), axis=-1).reshape(-1, 3)
    near = tried[np.argmax(log_p)] + finer
    near = near[(near[:, 2] > near[:, 1] + 0.03) & (near[:, 1] > 0.04)]
    fine, x = _posterior(edge, near, standing)
    mean, sigma = _moments(fine, near)
    # The wider search shows other places that are nearly as likely, of either kind of collar.
    _, wide = _moments(np.concatenate([p for p, _ in both]), np.vstack([tried, tried]))
    steps = np.array([_AXIS[2], _COLLAR[2], _SHOULDER[2]])
    sigma = np.maximum(sigma, np.sqrt(np.maximum(wide**2 - steps**2 / 6, 0.0)))
    c = x[np.argmax(fine)]
    side = np.array([1.0, -1.0])
    out = np.stack([side * mean[1], side * mean[2]])
    heights = c[0] + c[1] * out
    heights[1] += (c[2] + side * c[3]) * (mean[2] - mean[1])
    return heights, mean[0] + out, sigma[1:] * np.hypot(1.0, [0.0, c[2]])


def _moments(log_p: Array, at: Array) -> tuple[Array, Array]:
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    mean = p @ at
    return mean, np.sqrt(p @ (at - mean) ** 2)


def _posterior(edge: _Edge, knots: Array, standing: bool) -> tuple[Array, Array]:
    """Logarithm of the probability (m,) of the knots (m, 3), each axis, collar and shoulder, up to a constant, and
    the coefficients (m, 11)."""
    axis, collar, shoulder = (knots[:, k, None] for k in range(3))
    v = edge.b - axis
    u, side = np.abs(v), np.sign(v)
    slope, sleeve = np.clip(np.minimum(u, shoulder) - collar, 0.0, None), np.clip(u - shoulder, 0.0, None)
    bent = np.where(u < shoulder, slope * (slope - (shoulder - collar)), 0.0)
    if standing:
        neck, curve = (
            np.clip((collar - u) / _STAND, 0.0, 1.0),
            np.clip(1 - (u / (collar - _STAND)) ** 2, 0.0, None),
        )
    else:
        neck, curve = np.clip(1 - (u / collar) ** 2, 0.0, None), np.zeros_like(u)
    rows = [
        np.ones_like(v),
        v,
        slope,
        side * slope,
        sleeve,
        side * sleeve,
        bent,
        sleeve**2,
        side * sleeve**2,
        neck,
    ]
    A = np.stack([*rows, curve], axis=2)
    mean, sigma = _MEAN.copy(), _SIGMA.copy()
    mean[9], sigma[9] = _STANDING if standing else _DIP
    information = _STEP / _CORRELATION / _NOISE**2  # of one point, as neighbours are correlated
    y = edge.y - edge.y.mean()
    H = information * np.matmul(A.transpose(0, 2, 1), A) + np.diag(sigma**-2)
    g = information * np.matmul(A.transpose(0, 2, 1), y[:, None])[..., 0] + mean / sigma**2
    x = np.linalg.solve(H, g[..., None])[..., 0]
    residual = y - np.matmul(A, x[..., None])[..., 0]
    misfit = information * (residual**2).sum(axis=1) + (((x - mean) / sigma) ** 2).sum(axis=1)
    log_p = -0.5 * (len(y) * _STEP / _CORRELATION + _FREEDOM) * np.log1p(misfit / _FREEDOM)
    log_p -= 0.5 * np.linalg.slogdet(H)[1] + np.log(sigma).sum()
    x[:, 0] += edge.y.mean()
    above = x[:, 0] - edge.armpit
    falls = x[:, 2] * (shoulder - collar)[:, 0]
    rise = 1.0 + falls / np.maximum(above, 1e-3)
    droop = np.arctan2(x[:, 0] + falls - edge.cuff[0], edge.cuff[1] - shoulder[:, 0])
    for value, (usual, spread) in (
        (rise, _RISE),
        (shoulder[:, 0] / edge.half - _DROOP * droop, _WIDTH),
        ((collar / shoulder)[:, 0], _NECK),
        (axis[:, 0], (edge.middle, _OFFSET) if edge.neckline is None else (edge.neckline[0], _NECKLINE)),
        (collar[:, 0], (0.0, np.inf) if edge.neckline is None else (edge.neckline[1], _NECKLINE)),
        (axis[:, 0], (0.0, np.inf) if edge.seams is None else (edge.seams[0], np.hypot(_OFFSET, edge.seams[2]))),
        (shoulder[:, 0], (0.0, np.inf) if edge.seams is None else edge.seams[1:]),
    ):
        log_p -= 0.5 * ((value - usual) / spread) ** 2
    return log_p, x
