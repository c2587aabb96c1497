"""Records the ground truth of a simulated cell and scores it at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.config.garments.garment_file import load_garment
from cell.simulation.scoring.dwell import DwellTimes
from cell.simulation.scoring.ideal import BackgroundIdeal
from cell.simulation.simulated_cell import TruthSource
from cell.simulation.truth import GarmentTruth, Truth
from cell.states.fold_request import FoldRequest
from cell.view import Recorder
from robots.ports import Array, Side
from skills.garments.garment import Garment
from skills.scoring.score import score_plan
from skills.scoring.verdict import Score

__all__ = ["GroundTruthRecorder"]

MAX_KEY_FRAMES = 2000
LIFTED = 0.05
"""A garment that a hand holds above this height is being folded [m]."""


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
        """Begin to compute the ideal of the preferred way to fold."""
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
