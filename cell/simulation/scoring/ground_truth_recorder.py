"""Records the ground truth of a simulated cell and scores it at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.simulation.scoring.ideal import BackgroundIdeal
from foldcell.cell.simulation.simulated_cell import TruthSource
from foldcell.cell.simulation.truth import GarmentTruth, Truth
from foldcell.cell.states.fold_request import FoldRequest
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.ports import Array, Side
from foldcell.skills.garments.garment import Garment
from foldcell.skills.scoring.score import score_plan
from foldcell.skills.scoring.verdict import Score

MAX_KEY_FRAMES = 2000
LIFTED = 0.05
"""A garment that a hand holds above this height is being folded [m]."""


@dataclass
class DwellTimes:
    """Notes when hands hold the garment. A hold during which the garment was lifted counts as a fold."""

    _folds: list[tuple[float, float | None]] = field(default_factory=list)
    """Time of each fold's release, and of the next grasp [s]."""
    _held_at: float | None = None
    _lifted: bool = False

    def note(self, stamp: float, held: bool, lifted: bool) -> None:
        """Note at cell time `stamp` [s] whether a hand holds the garment, and whether it has lifted it."""
        if held:
            if self._held_at is None and self._folds and self._folds[-1][1] is None:
                self._folds[-1] = self._folds[-1][0], stamp
            self._held_at = stamp
            self._lifted = self._lifted or lifted
        elif self._held_at is not None:
            if self._lifted:
                self._folds.append((stamp, None))
            self._held_at, self._lifted = None, False

    def after_each(self, folds: int, end: float) -> Sequence[float] | None:
        """Return the time between the release of each fold and the next grasp, or `end` for the last [s]. None if
        the garment was not folded exactly `folds` times: then a fold was repeated, or not seen."""
        if len(self._folds) != folds:
            return None
        return [(end if grasp is None else grasp) - release for release, grasp in self._folds]


class GroundTruthRecorder:
    """Records one simulated cell from the moment when it is opened."""

    def __init__(self, truth: TruthSource, recorder: Recorder, request: FoldRequest) -> None:
        self._truth, self._recorder, self._request = truth, recorder, request
        self.key_frames: list[tuple[float, Array, dict[Side, Array]]] = []
        """(cell time [s], vertices (n, 3), tool positions (3,)) while a hand holds cloth, for the report."""
        self.triangles: NDArray[np.int32] | None = None
        self._ideal: BackgroundIdeal | None = None
        self._dwell = DwellTimes()
        truth.watch(self._record)

    def score(self, whole: bool = True) -> Score | None:
        """Score the final garment; None if no garment was laid. whole: whether all folds
        were made. The heights are judged only then, or if the shape passes, because the ideal fold takes time: a
        run that was stopped does not wait for it."""
        self._truth.watch(None)
        now = self._truth.now()
        garment = now.garment
        if garment is None:
            return None
        figures = score_plan(
            garment.vertices, garment.triangles, garment.material, garment.keypoints, self._nominal(garment),
            garment.thickness,
        )  # fmt: skip
        if garment.solver == "xpbd" and (whole or figures.shape):
            ideal = self._ideal or self._begin(garment)
            dwell_s = self._dwell.after_each(len(figures.lines), now.stamp)
            figures = figures.with_ideal(ideal.heights(figures.lines, dwell_s))
        self.close()
        return figures

    def close(self) -> None:
        """End the computation of the ideal fold."""
        if self._ideal is not None:
            self._ideal.cancel()

    def _begin(self, garment: GarmentTruth) -> BackgroundIdeal:
        """Begin to compute the ideal fold of the garment, for the preferred way of the garment's plan."""
        return BackgroundIdeal(garment, lambda: self._nominal(garment))

    def _nominal(self, garment: GarmentTruth) -> Garment:
        """The garment's file. A user's own file is judged by its own plan."""
        named = garment.name if self._request.garment == "auto" else self._request.garment
        return load_garment(named, self._request.settings.surface)

    def _record(self, truth: Truth) -> None:
        if truth.garment is None:
            return
        if self._ideal is None and truth.garment.solver == "xpbd":
            self._ideal = self._begin(truth.garment)
        holding = [truth.tools[side][2] for side, held in truth.held.items() if held]
        self._dwell.note(truth.stamp, bool(holding), max(holding, default=0.0) > LIFTED)
        self.triangles = truth.garment.triangles
        self._recorder.garment_truth(truth.stamp, truth.garment.vertices, truth.garment.triangles)
        if holding and len(self.key_frames) < MAX_KEY_FRAMES:
            self.key_frames.append((truth.stamp, truth.garment.vertices, dict(truth.tools)))
