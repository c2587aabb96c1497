"""The ideal fold of the simulated garment, with whose heights a run's heights are compared.

The ideal is the same garment with the same fabric, folded without grippers from its flat rest shape without
wrinkles, about the lines of the way that was taken. After each fold it settles until it rests, as a garment does
while the arms move on. It is computed in a thread while the run goes on. It has no influence on the run.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from cell.simulation.garment.cloth_body import solver_settings
from cell.simulation.scoring.score import FinalGarment, IdealHeights, score
from cell.simulation.truth import GarmentTruth
from skills.cloth.mesh import ClothMesh
from skills.cloth.settings import SolverSettings
from skills.fold_figures.fold_figures import measure_fold
from skills.planning.ideal_fold import REST_MOTION, IdealFold, ideal_folds
from skills.planning.turned_fold import TURN_S
from skills.vocabulary import Array, FoldLine, Material

__all__ = ["BackgroundIdeal", "flaw_of", "ideal_heights", "ideal_of"]

SETTLE_S = 1.5
"""Least simulated time for settling after each fold [s]. A run takes longer from the release to the next grasp."""
SLOWER = (1.0, 2.0, 4.0)
"""Durations of the turns of successive attempts, relative to the first one."""
MOST_STRAIN = 0.05
LEAST_IOU = 0.90
"""An ideal fold has to overlap with its target as a passed fold does."""


class Cancelled(Exception):
    """The ideal is no longer wanted."""


def ideal_heights(
    garment: GarmentTruth, lines: Sequence[FoldLine], go_on: Callable[[], None] = lambda: None
) -> IdealHeights:
    """Make the ideal fold of a garment about `lines` (table frame) and measure its heights. go_on: called often;
    it may raise an exception."""
    x, y, angle = garment.pose
    own = tuple(_in_garment_frame(line, x, y, angle) for line in lines)
    return ideal_of(garment.mesh, own, garment.fabric, solver_settings(garment.traits), go_on)[1]


def ideal_of(
    mesh: ClothMesh,
    lines: Sequence[FoldLine],
    material: Material,
    settings: SolverSettings,
    go_on: Callable[[], None] = lambda: None,
) -> tuple[Array, IdealHeights]:
    """Make the ideal fold about `lines` (in the frame of the mesh's rest shape). Returns its vertices (n, 3) and
    its heights. A fold with a flaw is made again, with slower turns."""
    for slower in SLOWER:
        fold = ideal_folds(mesh, lines, material, settings, SETTLE_S, go_on, slower * TURN_S)[-1]
        figures = measure_fold(fold.vertices, mesh.triangles, mesh.rest, lines)
        shape = score(FinalGarment(fold.vertices, mesh.triangles, mesh.rest, tuple(lines), material.thickness))
        flaw = flaw_of(fold, shape.iou)
        if flaw is None:
            break
    return fold.vertices, IdealHeights(figures.height, figures.crease_height, flaw)


def flaw_of(fold: IdealFold, iou: float) -> str | None:
    """Return why a fold cannot serve as the ideal, in words; None if it can. iou: overlap with its target."""
    if fold.crossings:
        return f"layers pass through each other at {fold.crossings} places"
    if fold.strain > MOST_STRAIN:
        return f"an edge away from creases is stretched by {100.0 * fold.strain:.1f} %"
    if fold.motion >= REST_MOTION:
        return f"it does not come to rest ({1e3 * fold.motion:.1f} mm in 0.1 s)"
    if iou < LEAST_IOU:
        return f"it overlaps with its target by {iou:.2f} only"
    return None


def _in_garment_frame(line: FoldLine, x: float, y: float, angle: float) -> FoldLine:
    c, s = np.cos(angle), np.sin(angle)
    back = np.array([[c, -s], [s, c]])
    return FoldLine((line.point - (x, y)) @ back, line.direction @ back)


class BackgroundIdeal:
    """Computes an ideal in a thread, from the moment when the garment lies."""

    def __init__(self, garment: GarmentTruth, lines: Callable[[], Sequence[FoldLine]]) -> None:
        """lines: returns the expected fold lines; called in the thread."""
        self._garment, self._lines = garment, lines
        self._cancelled = threading.Event()
        self._found: tuple[tuple[FoldLine, ...], IdealHeights] | None = None
        self._thread = threading.Thread(target=self._compute, name="ideal fold", daemon=True)
        self._thread.start()

    def heights(self, lines: tuple[FoldLine, ...]) -> IdealHeights:
        """Return the heights for `lines`. If they are not the expected lines, they are computed now."""
        self._thread.join()
        if self._found is not None and _same(self._found[0], lines):
            return self._found[1]
        return ideal_heights(self._garment, lines)

    def cancel(self) -> None:
        """End the computation, if it is not finished."""
        self._cancelled.set()
        self._thread.join()

    def _compute(self) -> None:
        try:
            lines = tuple(self._lines())
            self._found = lines, ideal_heights(self._garment, lines, self._check)
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
