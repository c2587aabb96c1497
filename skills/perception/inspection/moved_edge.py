"""Where the edge that a fold moved came to lie, told by one layer of cloth.

The moved edge lies on cloth of the same fabric: the silhouette shows nothing of it. But where the moved layers
came to lie, the surface rose by their thickness since the picture before the fold, and in front of their edge it
did not rise at all: wrinkles and creases that were there before cancel out. One pixel's depth noise is larger than
a layer, but the mean over a strip along the edge is ten times smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.perceive import smooth_height
from skills.perception.rectification.table_view import TableView
from skills.planning.folding import fold_xy
from skills.vocabulary import FoldStep, PredictedShape

__all__ = ["EdgeSettings", "MovedEdge", "moved_edge"]


_TOLERANCE = 0.010
"""Strips further than this from the fitted shape of an edge count less [m]."""


@dataclass(frozen=True)
class EdgeSettings:
    """Lengths [m]."""

    strips: int = 9
    """Along the moved edge, each looked at by itself."""
    outside: float = 0.024
    inside: float = 0.120
    """How far before and behind its predicted place the edge is looked for."""
    crease: float = 0.045
    """Nearer to the fold line nothing is judged: the crease stands up there."""
    rim: float = 0.010
    """Left out at the edge's two ends, where depth is lost."""
    loop: float = 0.006
    """Cloth that stood this much higher before the fold than the median of the stack is the loop of an earlier
    crease: what comes to lie on it presses it down, and nobody sees it rise."""
    least_rise: float = 0.0010
    """A thinner moved layer cannot be seen by depth."""
    sample: float = 0.002


@dataclass(frozen=True, eq=False)
class MovedEdge:
    """lag: (n,) how far behind its predicted place the edge lies [m], in strips from one end of it to the other,
    NaN where nobody can see it. rise: height of the moved layers where they surely lie [m]."""

    lag: Array
    rise: float

    @property
    def corner(self) -> float:
        """How much further behind one end lies than the other half of the edge [m]: the worse end that is seen."""
        behind = self._ends()
        return float(np.nanmax(behind)) if np.isfinite(behind).any() else float("nan")

    @property
    def wholly_seen(self) -> bool:
        """Whether both ends are seen, and enough between them."""
        return bool(np.isfinite([*self._ends(), self.sag]).all())

    @property
    def sag(self) -> float:
        """How much further behind the middle lies than the line between the two ends [m]: the amplitude of half a
        sine over a straight line, fitted to all strips with Huber's weights; NaN where too few are seen."""
        known = np.isfinite(self.lag)
        if np.count_nonzero(known) < 5:
            return float("nan")
        t = (np.flatnonzero(known) + 0.5) / len(self.lag)
        basis, lag = np.stack([1.0 - t, t, np.sin(np.pi * t)], axis=1), self.lag[known]
        weight = np.ones(len(lag))
        fit = np.zeros(3)
        for _ in range(5):
            fit = np.asarray(np.linalg.lstsq(basis * weight[:, None], lag * weight, rcond=None)[0], dtype=float)
            weight = np.sqrt(np.minimum(1.0, _TOLERANCE / np.maximum(np.abs(lag - basis @ fit), 1e-9)))
        return float(fit[2])

    def _ends(self) -> tuple[float, float]:
        """How much further behind each end lies than the other half of the edge [m]; NaN where it is not seen."""
        first, last = (self._end(lag) - _median(lag[len(lag) // 2 :]) for lag in (self.lag, self.lag[::-1]))
        return first, last

    @staticmethod
    def _end(lag: Array) -> float:
        """Of the first two strips that are seen, in the first third, the one that speaks against a lost corner."""
        seen = lag[: len(lag) // 3]
        seen = seen[np.isfinite(seen)][:2]
        return float(seen.min()) if len(seen) else float("nan")


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
    settings: EdgeSettings | None = None,
) -> MovedEdge | None:
    """Look for the edge in the rise of height since before the fold; None where nobody can see it.

    height, before: (H, W) [m] in `view`, after and before the fold, above the same empty table. R (2, 2), t (2,)
    [m]: the rigid motion that lays the prediction on what is seen; the cloth below went along with it.
    """
    settings = settings or EdgeSettings()
    expected = _expected_edge(predicted, step, settings)
    if expected is None:
        return None
    along, reach = expected
    line = step.line
    depth = np.arange(-settings.outside, settings.inside, settings.sample)
    # From the predicted edge back towards the fold line, whose normal points to what is moved away from it.
    across = -(reach[:, None] - depth[None, :])  # the moved part lies on the line's other side now
    there = line.point + along[:, None, None] * line.direction + across[..., None] * line.normal
    rise = _sampled(height, view, there @ R.T + t) - _sampled(before, view, there)
    stood = _sampled(smooth_height(before), view, there)
    rise[stood > _median(stood[:, depth > 0]) + settings.loop] = np.nan
    rise[across > -settings.crease] = np.nan
    profiles = [_mean(part) for part in np.array_split(rise, settings.strips)]
    inner = np.concatenate([p[depth > 0.5 * settings.inside] for p in profiles])
    # Not the median: a pile would make a single layer look like none.
    layer = float(np.nanquantile(inner, 0.3)) if np.isfinite(inner).any() else 0.0
    if layer < settings.least_rise:
        return None
    return MovedEdge(np.array([_step_at(p, depth, layer) for p in profiles]), layer)


def _expected_edge(
    predicted: PredictedShape, step: FoldStep, settings: EdgeSettings
) -> tuple[Array, Array] | None:
    """Places along the fold line (n,) and how far beyond it the moved part reaches there (n,) [m]."""
    moved = step.line.signed_distance(fold_xy(step.earlier, predicted.material)) > 0
    if np.count_nonzero(moved) < 10:
        return None
    xy = predicted.vertices[moved, :2]
    along, reach = (xy - step.line.point) @ step.line.direction, -step.line.signed_distance(xy)
    if not reach.max() > 0.0:  # nothing is predicted to come over the line
        return None
    far = reach > 0.6 * reach.max()
    low, high = along[far].min() + settings.rim, along[far].max() - settings.rim
    if high - low < 0.08:
        return None
    places = np.arange(low, high, settings.sample)
    # The mesh is coarser than the samples: its farthest vertex near each place, joined by straight lines.
    knots = np.linspace(low, high, max(round((high - low) / 0.03), 2))
    half = 0.6 * (knots[1] - knots[0])
    tops = np.array([reach[np.abs(along - k) <= half].max(initial=-np.inf) for k in knots])
    good = np.isfinite(tops)
    return (places, np.interp(places, knots[good], tops[good])) if good.any() else None


def _sampled(image: NDArray[np.float32], view: TableView, xy: Array) -> Array:
    """Values of a view image at places (n, m, 2) [m]; NaN beside what is unknown."""
    at = view.to_pixel(xy).astype(np.float32)
    return cv2.remap(
        image, at[..., 0], at[..., 1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
    ).astype(float)


def _mean(rise: Array) -> Array:
    """Mean (m,) over a strip's samples (n, m) across the edge, NaN where too few are known."""
    known = np.isfinite(rise)
    count = known.sum(axis=0)
    total = np.where(known, rise, 0.0).sum(axis=0)
    return np.where(count > 0.25 * len(rise), total / np.maximum(count, 1), np.nan)


def _step_at(profile: Array, depth: Array, layer: float) -> float:
    """The place of a step from 0 to `layer` in a profile (m,), least squares; NaN where too little is known."""
    known = np.isfinite(profile)
    if np.count_nonzero(known) < 20:
        return float("nan")
    # A sample before the step costs rise^2, one behind it (rise - layer)^2: the sum of their differences.
    odds = np.where(known, 0.5 * layer - np.clip(profile, -0.5 * layer, 1.5 * layer), 0.0)
    total = np.r_[0.0, np.cumsum(odds)]
    return float(np.r_[depth, 2 * depth[-1] - depth[-2]][int(np.argmax(total))])
