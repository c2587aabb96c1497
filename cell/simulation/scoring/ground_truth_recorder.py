"""Records the ground truth of a simulated cell and scores it at the end."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.config.garments.garment_file import load_garment
from cell.recording.rerun import Recorder
from cell.simulation.scoring.score import score_plan
from cell.simulation.simulated_cell import TruthSource
from cell.simulation.truth import Truth
from cell.states.fold_request import FoldRequest
from robots.ports import Array, Side

__all__ = ["GroundTruthRecorder"]

MAX_KEY_FRAMES = 2000


class GroundTruthRecorder:
    """Records one simulated cell from the moment when it is opened."""

    def __init__(self, truth: TruthSource, recorder: Recorder, request: FoldRequest) -> None:
        self._truth, self._recorder, self._request = truth, recorder, request
        self.key_frames: list[tuple[float, Array, dict[Side, Array]]] = []
        """(cell time [s], vertices (n, 3), tool positions (3,)) while a hand holds cloth, for the report."""
        self.triangles: NDArray[np.int32] | None = None
        truth.watch(self._record)

    def score(self) -> dict[str, Any] | None:
        """Score the final garment and return the figures; None if no garment was laid."""
        self._truth.watch(None)
        garment = self._truth.now().garment
        if garment is None:
            return None
        named = garment.name if self._request.garment == "auto" else self._request.garment
        nominal = load_garment(named, self._request.settings.surface)  # a user's file is judged by its own plan
        figures = score_plan(
            garment.vertices, garment.triangles, garment.material, garment.keypoints, nominal, garment.thickness
        )
        return {"simulated": True, **figures.to_json()}

    def _record(self, truth: Truth) -> None:
        if truth.garment is None:
            return
        self.triangles = truth.garment.triangles
        self._recorder.garment_truth(truth.stamp, truth.garment.vertices, truth.garment.triangles)
        if any(truth.held.values()) and len(self.key_frames) < MAX_KEY_FRAMES:
            self.key_frames.append((truth.stamp, truth.garment.vertices, dict(truth.tools)))
