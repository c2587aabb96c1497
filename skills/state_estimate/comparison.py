"""Compares one hypothesis with the picture: aligns its silhouette, and measures the misfit of outline and heights.

The table is divided into square cells. Each cell has two residuals: of the share that is covered with cloth, and
of the mean height of the cloth. The camera's noise in the mean of a cell is about 0.1 mm; the errors of the
simulated shape are larger. The residuals are therefore scaled by the errors that correct simulations have
(COVERAGE, HEIGHT), and their misfit is the negative logarithm of Student's t density, which grows slowly for
outliers: one rucked corner must not outweigh the rest of the garment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.inspection.predicted_view import draw_shape, move_view, outline_of
from foldcell.skills.perception.rectification.heights import LOFTY
from foldcell.skills.perception.registration.alignment import align
from foldcell.skills.plane import rotation
from foldcell.skills.state_estimate.hypothesis import Hypothesis
from foldcell.skills.state_estimate.observation import Observation
from foldcell.skills.vocabulary import PredictedShape

CELL = 0.024  # edge of a cell [m]
# Standard deviation of the covered share of a cell on the outline: the error of the outline divided by CELL
COVERAGE = 0.25
# Standard deviation of the height of a cell [m], and its part that is proportional to the predicted height
# (creases bulge more or less than predicted)
HEIGHT, HEIGHT_SHARE = 0.002, 0.35
SHIFT = 0.012  # distance by which an edge of an upper layer may lie beside its predicted place [m]
FREEDOM = 3.0  # degrees of freedom of Student's t
OVERLAP = 0.3  # a height is compared if more than this share of the cell is cloth in picture and hypothesis
BAD = 2.0  # A cell with a larger misfit counts as unexplained


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis, moved to where it fits the picture best.

    about: (2,) centre of its outline [m]; drift: (2,) displacement of this centre [m]; drift_rad: angle by which
    it is turned. outline: (k, 2) its outline after the motion [m]. misfit: sum over the cells; cells: number of
    cells with cloth, in the picture or in the hypothesis; unexplained_m2: area of the cells with a large misfit.
    """

    hypothesis: Hypothesis
    about: Array
    drift: Array
    drift_rad: float
    outline: Array
    misfit: float
    cells: int
    unexplained_m2: float

    @property
    def drift_m(self) -> float:
        return float(np.linalg.norm(self.drift))

    @property
    def shape(self) -> PredictedShape:
        """The shape of the hypothesis at the place where it fits."""
        return replace(self.hypothesis.shape, vertices=self.placed(self.hypothesis.shape.vertices))

    def placed(self, vertices: Array) -> Array:
        """Displace vertices (n, 3) [m] as the fit displaces the hypothesis."""
        moved = (vertices[:, :2] - self.about) @ rotation(self.drift_rad).T + self.about + self.drift
        return frozen(np.column_stack([moved, vertices[:, 2]]))

    def taken_back(self, vertices: Array) -> Array:
        """Reverse `placed`: return the vertices (n, 3) [m] that it displaces to `vertices`."""
        back = (vertices[:, :2] - self.about - self.drift) @ rotation(self.drift_rad) + self.about
        return frozen(np.column_stack([back, vertices[:, 2]]))


def fit(
    seen: Observation,
    hypothesis: Hypothesis,
    lift: float = 0.0,
    turns: tuple[float, ...] = (0.0,),
) -> Fit:
    """Fit a hypothesis to the picture. lift: height by which the camera sees the flat garment above its mesh [m].
    turns: angles from which the alignment begins [rad]; the best result counts.

    Raises ValueError if the shape lies outside the view.
    """
    expected = draw_shape(seen.view, hypothesis.shape) + np.float32(lift)
    outline = outline_of(seen.view, np.isfinite(expected))
    fits = [_fit_from(seen, hypothesis, expected, outline, turn) for turn in turns]
    return min(fits, key=lambda f: f.misfit)


def _fit_from(
    seen: Observation,
    hypothesis: Hypothesis,
    expected: NDArray[np.float32],
    outline: Array,
    turn: float,
) -> Fit:
    about = outline.mean(axis=0)
    first = rotation(turn)
    turned = (outline - about) @ first.T + about
    R, t = align(turned, seen.contour)
    t = R @ (about - first @ about) + t
    R = R @ first
    moved = move_view(seen.view, expected, R, t)
    misfit, cells, bad = _misfit(seen, moved)
    return Fit(
        hypothesis,
        frozen(about),
        frozen(R @ about + t - about),
        float(np.arctan2(R[1, 0], R[0, 0])),
        frozen(outline @ R.T + t),
        misfit,
        cells,
        bad * CELL**2,
    )


def _misfit(seen: Observation, moved: NDArray[np.float32]) -> tuple[float, int, int]:
    """Return the misfit of a drawn hypothesis, the number of cells with cloth, and the number of unexplained
    cells."""
    size = max(round(CELL / seen.view.pixel), 1)
    drawn = np.isfinite(moved)
    covered, planned = (_cell_means(mask.astype(np.float32), size) for mask in (seen.mask, drawn))
    each = _student((covered - planned) / COVERAGE)
    both = seen.mask & drawn & np.isfinite(seen.height)
    share = _cell_means(both.astype(np.float32), size)
    known = share > OVERLAP
    if known.any():
        height, low, expected, high = (
            _cell_means(np.where(both, image, np.float32(0.0)), size)[known] / share[known]
            for image in (seen.height, *_neighbourhood(moved, seen.view.pixel))
        )
        gain = _gain(height, expected)
        nearest = np.clip(height, gain * low, gain * high)
        scale = np.hypot(HEIGHT, HEIGHT_SHARE * gain * expected)
        each[known] += _student((height - nearest) / scale)
    cloth = (covered > 0.02) | (planned > 0.02)
    return (
        float(each[cloth].sum()),
        int(np.count_nonzero(cloth)),
        int(np.count_nonzero(each[cloth] > BAD)),
    )


def _neighbourhood(
    moved: NDArray[np.float32], pixel: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the lowest, the own and the highest predicted height within SHIFT of each pixel; 0 without
    cloth."""
    size = 2 * round(SHIFT / pixel) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    inside = np.isfinite(moved)
    low = cv2.erode(np.where(inside, moved, np.float32(np.inf)), kernel)
    high = cv2.dilate(np.where(inside, moved, np.float32(0.0)), kernel)
    low, own, high = (np.where(inside, image, np.float32(0.0)) for image in (low, moved, high))
    return low.astype(np.float32), own.astype(np.float32), high.astype(np.float32)


def _gain(height: Array, expected: Array) -> float:
    """Estimate the ratio of the observed heights (n,) to the expected ones, as the median weighted by the expected
    heights. The result is limited to the ratios that a fabric's thickness can cause (LOFTY)."""
    ratio = height / np.maximum(expected, 1e-4)
    order = np.argsort(ratio)
    weight = np.cumsum(expected[order])
    middle = ratio[order][int(np.searchsorted(weight, 0.5 * weight[-1]))]
    return float(np.clip(middle, 1.0 / LOFTY, LOFTY))


def _cell_means(image: NDArray[np.float32], size: int) -> Array:
    """Average an image over squares of `size` pixels; incomplete squares at the far ends are left out."""
    rows, columns = (n // size for n in image.shape)
    cut = image[: rows * size, : columns * size]
    return np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), dtype=float)


def _student(residual: Array) -> Array:
    """Negative logarithm of Student's t density, without its constant."""
    return np.asarray(0.5 * (FREEDOM + 1.0) * np.log1p(residual**2 / FREEDOM))
