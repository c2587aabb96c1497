"""The ideal fold of the simulated garment, with whose heights a run's heights are compared.

The ideal is the same garment with the same fabric, folded without grippers from its flat rest shape without
wrinkles, about the fold lines of the way that the run took. After each fold it settles as long as the garment did
in the run. It is computed in a thread while the run goes on. It has no influence on the run.

The thread cannot know how long the garment will lie after each fold. A garment whose vertices all sleep does not
move any more, so a longer time changes nothing. The thread therefore lets each fold settle until the garment
sleeps (SETTLE_S at most). Only if the run gave a fold less time than that, the ideal is computed again.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence

import numpy as np

from foldcell.cell.simulation.garment.cloth_body import solver_settings
from foldcell.cell.simulation.truth import GarmentTruth
from foldcell.robots.errors import CellError
from foldcell.skills.cloth.strain import MOST_STRAIN
from foldcell.skills.fold_plan.ideal_fold import REST_MOTION, SETTLE_S, IdealFold, ideal_folds
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.fold_plan.turned_fold import TURN_S
from foldcell.skills.garments.garment import Garment
from foldcell.skills.scoring.alignment import FinalGarment
from foldcell.skills.scoring.score import named_edge_pairs, score
from foldcell.skills.scoring.verdict import IdealHeights
from foldcell.skills.vocabulary import Array, FoldLine

SLOWER = (1.0, 2.0, 4.0)
"""Durations of the turns in successive attempts, relative to the first attempt."""
LEAST_IOU = 0.90
"""An ideal fold has to overlap with its target as a passed fold does."""


class Cancelled(Exception):
    """The ideal is no longer wanted."""


def ideal_heights(
    garment: GarmentTruth,
    nominal: Garment,
    lines: Sequence[FoldLine],
    settle_s: float | Sequence[float] = SETTLE_S,
) -> IdealHeights:
    """Make the ideal fold of a garment about `lines` (table frame) and measure its heights. nominal: the garment's
    file; settle_s: as for `ideal_folds`. A fold that cannot be simulated has a flaw."""
    try:
        return ideal_of(garment, nominal, lines, settle_s)[1]
    except CellError as e:
        return _impossible(e)


def ideal_of(
    garment: GarmentTruth,
    nominal: Garment,
    lines: Sequence[FoldLine],
    settle_s: float | Sequence[float] = SETTLE_S,
    go_on: Callable[[], None] = lambda: None,
) -> tuple[tuple[IdealFold, ...], IdealHeights]:
    """Make the ideal fold like `ideal_heights`. Return all folds, in the garment's own frame, and the heights of
    the last one. go_on: as for `ideal_folds`, whose errors it raises.

    A fold is made again, with slower turns, if it has a flaw, or if its own shape does not pass the score: creases
    of stiff cloth that lie on each other can push the layers aside.
    """
    mesh, fabric, settings = garment.mesh, garment.fabric, solver_settings(garment.traits)
    own, keypoints = _own(garment, lines), _own_points(garment)
    pairs = named_edge_pairs(nominal.edge_pairs, keypoints)
    found: list[tuple[tuple[IdealFold, ...], IdealHeights]] = []
    for slower in SLOWER:
        folds = ideal_folds(mesh, own, fabric, settings, settle_s, go_on, slower * TURN_S)
        last = folds[-1]
        final = FinalGarment(last.vertices, mesh.triangles, mesh.rest, own, garment.thickness, pairs, keypoints)
        seen = score(final)
        height, crease_height = (seen.figures[name].value for name in ("height_m", "crease_height_m"))
        flaw = flaw_of(last, seen.iou)
        heights = IdealHeights(height, crease_height, flaw, last.crossings, last.strain, last.motion, seen.iou)
        found.append((folds, heights))
        if flaw is None and seen.shape:
            return found[-1]
    return next((ideal for ideal in found if ideal[1].flaw is None), found[-1])


def flaw_of(fold: IdealFold, iou: float) -> str | None:
    """Return why a fold cannot serve as the ideal, in words; None if it can. iou: overlap with its target."""
    if fold.crossings:
        return f"layers pass through each other at {fold.crossings} places"
    if fold.strain > MOST_STRAIN:
        return f"an edge away from creases is strained by {100.0 * fold.strain:.1f} %"
    if fold.motion >= REST_MOTION:
        return f"it does not come to rest ({1e3 * fold.motion:.1f} mm in 0.1 s)"
    if iou < LEAST_IOU:
        return f"it overlaps with its target by {iou:.2f} only"
    return None


def _impossible(error: CellError) -> IdealHeights:
    return IdealHeights(math.nan, math.nan, f"it cannot be simulated: {error.what}", 0, *3 * (math.nan,))


def _own(garment: GarmentTruth, lines: Sequence[FoldLine]) -> tuple[FoldLine, ...]:
    """Return lines of the table frame in the garment's own frame."""
    offset, back = _back(garment)
    return tuple(FoldLine((line.point - offset) @ back, line.direction @ back) for line in lines)


def _own_points(garment: GarmentTruth) -> dict[str, Array]:
    """Return the true key points in the garment's own frame."""
    offset, back = _back(garment)
    return {name: (p - offset) @ back for name, p in garment.keypoints.items()}


def _back(garment: GarmentTruth) -> tuple[Array, Array]:
    x, y, angle = garment.pose
    c, s = np.cos(angle), np.sin(angle)
    return np.array([x, y]), np.array([[c, -s], [s, c]])


class BackgroundIdeal:
    """Computes an ideal in a thread, from the moment when the garment lies."""

    def __init__(self, garment: GarmentTruth, nominal: Callable[[], Garment]) -> None:
        """nominal: returns the garment's file; called in the thread. The preferred way of its plan is expected."""
        self._garment, self._nominal = garment, nominal
        self._cancelled = threading.Event()
        self._found: tuple[tuple[FoldLine, ...], tuple[IdealFold, ...], IdealHeights] | None = None
        self._thread = threading.Thread(target=self._compute, name="ideal fold", daemon=True)
        self._thread.start()

    def heights(self, lines: tuple[FoldLine, ...], dwell_s: Sequence[float] | None = None) -> IdealHeights:
        """Return the heights for `lines`. dwell_s: time that the run gave each fold to settle [s]; None: not
        known. If the thread has not computed these heights, they are computed now."""
        self._thread.join()
        times = [SETTLE_S] * len(lines) if dwell_s is None else [min(t, SETTLE_S) for t in dwell_s]
        if self._found is not None and _same(self._found[0], lines):
            _, folds, heights = self._found  # without folds, the garment cannot be simulated
            if all(t >= min(SETTLE_S, fold.rest_s) for t, fold in zip(times, folds, strict=False)):
                return heights
        return ideal_heights(self._garment, self._nominal(), lines, times)

    def cancel(self) -> None:
        """End the computation, if it is not finished."""
        self._cancelled.set()
        self._thread.join()

    def _compute(self) -> None:
        try:
            nominal = self._nominal()
            lines = ways_to_fold(nominal, self._garment.keypoints)[0]
            try:
                self._found = lines, *ideal_of(self._garment, nominal, lines, go_on=self._check)
            except CellError as e:
                self._found = lines, (), _impossible(e)
        except Exception:  # the computation is repeated, with its error, if its result is wanted
            self._found = None

    def _check(self) -> None:
        if self._cancelled.is_set():
            raise Cancelled


def _same(a: Sequence[FoldLine], b: Sequence[FoldLine]) -> bool:
    return len(a) == len(b) and all(
        np.array_equal(p.point, q.point) and np.array_equal(p.direction, q.direction)
        for p, q in zip(a, b, strict=True)
    )
