"""Locates the edge that a fold moved, by the rise of the surface by one layer of cloth.

The moved edge lies on cloth of the same fabric, so neither colour nor silhouette shows it. Where the moved layers
lie, however, the surface has risen by their thickness since the picture before the fold; in front of the edge it
has not. Earlier wrinkles and creases cancel out in the difference. The depth noise of one pixel is larger than the
thickness of a layer, but the noise of the mean over a strip along the edge is ten times smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.perception.rectification.heights import smooth_height
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import FoldStep, PredictedShape

SHORTEST = 0.08
"""Edges that are shorter are not judged [m]."""
_STRIPS = 9
"""Smallest number of strips into which the moved edge is divided along its length."""
_STRIP_WIDTH, _STRIP_RISE = 0.012, 0.0042
"""Width of a strip if the layers raise the surface by `_STRIP_RISE` or more [m]. A small corner that is turned in
is wider than two such strips. The noise of a strip's mean falls with the square root of its width. Strips of
thinner layers are therefore wider by the square of the ratio of the rises."""
_OUTSIDE, _INSIDE = 0.024, 0.120
"""The edge is searched from `_OUTSIDE` in front of its predicted place to `_INSIDE` behind this place [m]."""
_CREASE = 0.045
"""Nearer than this to the fold line, no rise is measured, because the crease is raised there [m]."""
_RIM = 0.010
"""Length ignored at the two ends of the edge, where depth is missing [m]."""
_LOWEST_LOOP, _HIGHEST_LOOP = 0.002, 0.006
"""The crease of an earlier fold forms a loop that stands above the stack. New layers press the loop down, so no
rise is measured there. Cloth counts as part of a loop if it was higher than the stack's median height by more than
the rise of the new layers; this limit is at least `_LOWEST_LOOP` and at most `_HIGHEST_LOOP` [m]."""
_FLANK = 0.030
"""Up to this distance beside such a loop, no rise is measured where the cloth was higher than the stack's median
height by more than half of the new layers' rise [m]."""
_MIN_RISE = 0.0010
"""Minimum rise of the surface, because depth cannot resolve thinner moved layers [m]."""
_SAMPLE = 0.002
"""Distance of the samples [m]."""
_TOLERANCE = 0.010
"""Huber threshold: in the fit of an edge, strips whose lag differs from the fit by more than this count
less [m]."""

_MAD = 1.4826
"""Standard deviation of normal errors, relative to the median of their absolute values."""


@dataclass(frozen=True, eq=False)
class MovedEdge:
    """The place of the moved edge. lag: (n,) distance of the edge behind its predicted place in n strips from one
    end to the other [m], NaN where unknown. rise: height of the moved layers [m]. on_crease: whether the first and
    the last strip lie on the loop of an earlier crease. The step is several layers high there, and such a strip is
    not misplaced by noise. noise: noise of a strip's lag, relative to that of a strip that is as wide as its
    layers require. It is larger than 1 if the edge is too short for such strips."""

    lag: Array
    rise: float
    on_crease: tuple[bool, bool] = (False, False)
    noise: float = 1.0

    @property
    def corner(self) -> float:
        """Lag of an end minus the median lag of the opposite half of the edge, for the worse of the visible ends
        [m]; NaN if neither end is visible."""
        behind = self._ends()
        return float(np.nanmax(behind)) if np.isfinite(behind).any() else float("nan")

    @property
    def wholly_seen(self) -> bool:
        """Whether both ends, up to their last strip, and enough of the edge between them are visible."""
        return bool(np.isfinite([self.lag[0], self.lag[-1], *self._ends(), self.sag]).all())

    @property
    def sag(self) -> float:
        """Lag of the middle of the edge relative to the straight line between its two ends [m]; NaN if too few
        strips are visible."""
        return self._fitted_sag()[0]

    @property
    def sag_error(self) -> float:
        """Standard error of the sag, by the median residual of its fit [m]; NaN if there is none."""
        return self._fitted_sag()[1]

    def _fitted_sag(self) -> tuple[float, float]:
        """Fit the sum of a straight line and half a sine to the lags of all strips with Huber's weights. Returns
        the amplitude of the sine and its standard error [m]; NaN if fewer than five strips are visible."""
        known = np.isfinite(self.lag)
        count = np.count_nonzero(known)
        if count < 5:
            return float("nan"), float("nan")
        t = (np.flatnonzero(known) + 0.5) / len(self.lag)
        basis, lag = np.stack([1.0 - t, t, np.sin(np.pi * t)], axis=1), self.lag[known]
        weight = np.ones(len(lag))
        fit = np.zeros(3)
        for _ in range(5):
            fit = np.asarray(np.linalg.lstsq(basis * weight[:, None], lag * weight, rcond=None)[0], dtype=float)
            weight = np.sqrt(np.minimum(1.0, _TOLERANCE / np.maximum(np.abs(lag - basis @ fit), 1e-9)))
        sigma = _MAD * float(np.median(np.abs(lag - basis @ fit))) * math.sqrt(count / (count - 3))
        return float(fit[2]), sigma * math.sqrt(float(np.linalg.inv(basis.T @ basis)[2, 2]))

    def _ends(self) -> tuple[float, float]:
        """For each end, its lag minus the median lag of the opposite half of the edge [m]; NaN if the end is not
        visible."""
        ends = zip((self.lag, self.lag[::-1]), self.on_crease, strict=True)
        first, last = (self._end(lag, sure) - _median(lag[len(lag) // 2 :]) for lag, sure in ends)
        return first, last

    @staticmethod
    def _end(lag: Array, sure: bool) -> float:
        """Lag of the end at which `lag` begins [m]: the median of the first three visible strips in the first
        third of the edge, or the smaller lag of the first two. Thus a single misplaced strip neither causes a
        false alarm nor hides a corner. NaN if no strip is visible there. sure: the first strip cannot be
        misplaced, so that the end lags by no more than this strip."""
        seen = lag[: len(lag) // 3]
        seen = np.sort(seen[np.isfinite(seen)][:3])
        end = float(seen[(len(seen) - 1) // 2]) if len(seen) else float("nan")
        return min(end, float(lag[0])) if sure and np.isfinite(lag[0]) else end


def _median(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else float("nan")


def moved_edge(
    height: NDArray[np.float32],
    before: NDArray[np.float32],
    predicted: PredictedShape,
    step: FoldStep,
    view: TableView,
    R: Array,
    t: Array,
    flat: PredictedShape | None = None,
) -> MovedEdge | None:
    """Locate the edge by the rise of height during the fold; None if it cannot be measured.

    height, before: (H, W) height in `view` after and before the fold, above the same empty table [m]. R (2, 2), t
    (2,) [m]: the rigid motion that aligns the prediction with the observation. It is assumed that the cloth below
    has made the same motion. flat: the perfectly flat fold, with the triangles of `predicted`; it gives the
    thickness of the moved layers. Without it, the rise behind the edge counts as this thickness. Loose layers
    stand higher there than at their edge, so the edge is then found too far behind.
    """
    expected = _expected_edge(predicted, step)
    if expected is None:
        return None
    along, reach = expected
    line = step.line
    depth = np.arange(-_OUTSIDE, _INSIDE, _SAMPLE)
    # Samples run from the predicted edge back towards the fold line. The line's normal points to the side that is
    # folded over, so the moved part now lies at negative distances.
    across = -(reach[:, None] - depth[None, :])
    places = line.point + along[:, None, None] * line.direction + across[..., None] * line.normal
    rise = _sampled(height, view, places @ R.T + t) - _sampled(before, view, places)
    height_before = _sampled(smooth_height(before), view, places)
    rise[across > -_CREASE] = np.nan
    raised = height_before - _median(height_before[:, depth > 0])
    layer = _layer(np.where(raised > _HIGHEST_LOOP, np.nan, rise), depth)
    loop = raised > np.clip(layer, _LOWEST_LOOP, _HIGHEST_LOOP)
    near = binary_dilation(loop, iterations=round(_FLANK / _SAMPLE))
    pressed = loop | (near & (raised > 0.5 * layer))
    crossing = _crossing_creases(rise, pressed, depth, layer)
    raised[crossing & pressed] = 0.0
    rise[pressed & ~crossing] = np.nan
    raised[np.isnan(rise)] = np.nan
    layer = _layer(rise, depth)
    if layer < _MIN_RISE:
        return None
    width = _STRIP_WIDTH * max(1.0, _STRIP_RISE / layer) ** 2
    count = max(_STRIPS, round(len(rise) * _SAMPLE / width))
    edge = layer if flat is None else min(layer, max(_thickness_moved(flat, step), _MIN_RISE))
    parts = [np.array_split(values, count) for values in (rise, raised, crossing)]
    behind = [_step_place(_mean(r), _mean(above), depth, edge) for r, above, _ in zip(*parts, strict=True)]
    # where the edge is oblique, its distance is shorter than that across the fold line
    slope = [float(np.mean(part)) for part in np.array_split(np.gradient(reach, _SAMPLE), count)]
    lag, on_crease = np.array(behind) / np.hypot(1.0, slope), (bool(parts[2][0].all()), bool(parts[2][-1].all()))
    noise = max(1.0, (width / (len(rise) * _SAMPLE / count)) ** 0.5)
    return MovedEdge(lag, layer, on_crease, noise)


def _crossing_creases(rise: Array, pressed: NDArray[np.bool_], depth: Array, layer: float) -> NDArray[np.bool_]:
    """Return (n, 1) whether, in each row, the crease of the new layers visibly lies on the loop of the earlier
    crease. It does where the surface well behind the edge rose by more than the layers. The loop is then not
    pressed flat."""
    wide = max(1, round(_STRIP_WIDTH / _SAMPLE))
    inner = depth > 0.5 * _INSIDE
    rows = np.zeros(len(rise), dtype=bool)
    for part in np.array_split(np.arange(len(rise)), max(1, len(rise) // wide)):
        rows[part] = pressed[part].any() and _median(rise[np.ix_(part, inner)]) > layer
    return rows[:, None]


def _thickness_moved(flat: PredictedShape, step: FoldStep) -> float:
    """Return how thick the moved layers are at the edge, in the perfectly flat fold [m]: the median over short
    pieces of the edge. The lowest vertices of the fold lie half a thickness above the table."""
    thickness = 2.0 * float(flat.vertices[:, 2].min())
    moved = step.line.signed_distance(fold_xy(step.earlier, flat.material)) > 0
    x = flat.vertices[moved]
    reach, along = -step.line.signed_distance(x[:, :2]), (x[:, :2] - step.line.point) @ step.line.direction
    outer = reach > 0.6 * reach.max()
    piece, z = np.floor(along[outer] / 0.03).astype(int), x[outer, 2]
    spreads = [float(np.ptp(z[piece == k])) for k in np.unique(piece)]
    return thickness + float(np.median(spreads))


def _layer(rise: Array, depth: Array) -> float:
    """Return the height of the moved layers [m], well behind the edge; 0 if nothing is known there.

    A low quantile is used, because the median can lie in a pile of cloth; a single layer next to the pile would
    then be missed.
    """
    profiles = [_mean(part) for part in np.array_split(rise, _STRIPS)]
    inner = np.concatenate([p[depth > 0.5 * _INSIDE] for p in profiles])
    return float(np.nanquantile(inner, 0.3)) if np.isfinite(inner).any() else 0.0


def _expected_edge(predicted: PredictedShape, step: FoldStep) -> tuple[Array, Array] | None:
    """Return positions (n,) along the fold line, and the predicted distance (n,) to which the moved part reaches
    beyond the line there [m]; None if too little cloth was moved."""
    moved = step.line.signed_distance(fold_xy(step.earlier, predicted.material)) > 0
    if np.count_nonzero(moved) < 10:
        return None
    xy = predicted.vertices[:, :2]
    along, reach = (xy - step.line.point) @ step.line.direction, -step.line.signed_distance(xy)
    if not reach[moved].max() > 0.0:  # no cloth is predicted beyond the line
        return None
    triangles = predicted.triangles[moved[predicted.triangles].all(axis=1)]
    sides = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    places = np.arange(along[moved].min(), along[moved].max(), _SAMPLE)
    farthest = _farthest(along[sides], reach[sides], places)
    outermost = places[farthest > 0.6 * farthest.max(initial=0.0)]
    if not len(outermost) or np.ptp(outermost) < SHORTEST + 2.0 * _RIM:
        return None
    inner = (places >= outermost[0] + _RIM) & (places <= outermost[-1] - _RIM)
    return places[inner], farthest[inner]


def _farthest(along: Array, reach: Array, places: Array) -> Array:
    """Return how far line segments reach at places (n,) along the fold line [m]. along, reach: (m, 2) of the
    segments' ends. -inf where there is none."""
    order = np.argsort(along, axis=1)
    (start, end), (first, last) = (np.take_along_axis(values, order, axis=1).T for values in (along, reach))
    share = (places[:, None] - start) / np.maximum(end - start, 1e-9)
    crosses = (share >= 0.0) & (share <= 1.0)
    return np.asarray(np.where(crosses, first + share * (last - first), -np.inf).max(axis=1, initial=-np.inf))


def _sampled(image: NDArray[np.float32], view: TableView, xy: Array) -> Array:
    """Return the values (n, m) of a view image at places (n, m, 2) [m]; NaN outside the view and where unknown."""
    at = view.to_pixel(xy).astype(np.float32)
    return cv2.remap(
        image, at[..., 0], at[..., 1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
    ).astype(float)


def _mean(rise: Array) -> Array:
    """Average the n profiles of a strip, rise (n, m), to one profile (m,) across the edge; NaN where too few
    values are known."""
    known = np.isfinite(rise)
    count = known.sum(axis=0)
    total = np.where(known, rise, 0.0).sum(axis=0)
    return np.where(count > 0.25 * len(rise), total / np.maximum(count, 1), np.nan)


def _step_place(rise: Array, raised: Array, depth: Array, layer: float) -> float:
    """Find the place [m] behind which layers lie that are `layer` [m] thick, by least squares; NaN if too few
    values are known.

    rise, raised: profiles (m,) of a strip: the rise of the surface, and the height of the surface before above the
    stack's median height [m]. Layers either follow a wrinkle or the flank of a crease below them, so that the
    surface rises by their thickness, or press it down to the height of the stack.
    """
    known = np.isfinite(rise)
    if np.count_nonzero(known) < 20:
        return float("nan")
    pressed = rise + np.maximum(raised, 0.0)
    squares = np.minimum((rise - layer) ** 2, (pressed - layer) ** 2) - rise**2
    # A sample costs rise^2 in front of the step. At the best step, the sum of (cost behind - cost in front) over
    # all samples in front of the step is largest.
    cost_difference = np.where(known, np.clip(squares / (2.0 * layer), -layer, layer), 0.0)
    total = np.r_[0.0, np.cumsum(cost_difference)]
    return float(np.r_[depth, 2 * depth[-1] - depth[-2]][int(np.argmax(total))])
