"""Records what is really so in a simulated cell, and scores it at the end. Nothing waits for it."""

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

KEPT = 2000


class GroundTruthRecorder:
    """Watches one simulated cell from its opening on."""

    def __init__(self, truth: TruthSource, recorder: Recorder, request: FoldRequest) -> None:
        self._truth, self._recorder, self._request = truth, recorder, request
        self.key_frames: list[tuple[float, Array, dict[Side, Array]]] = []
        """(cell time, vertices, tool positions) while a hand holds cloth, for the report's pictures."""
        self.triangles: NDArray[np.int32] | None = None
        truth.watch(self._saw)

    def score(self) -> dict[str, Any] | None:
        """The final figures (design: the score), None when no garment was laid."""
        self._truth.watch(None)
        garment = self._truth.now().garment
        if garment is None:
            return None
        named = garment.name if self._request.garment == "auto" else self._request.garment
        nominal = load_garment(named, self._request.settings.surface)  # a file of one's own is judged by its plan
        figures = score_plan(
            garment.vertices, garment.triangles, garment.material, garment.keypoints, nominal, garment.thickness
        )
        return {"simulated": True, **figures.to_json()}

    def _saw(self, seen: Truth) -> None:
        if seen.garment is None:
            return
        self.triangles = seen.garment.triangles
        self._recorder.garment_truth(seen.stamp, seen.garment.vertices, seen.garment.triangles)
        if any(seen.held.values()) and len(self.key_frames) < KEPT:
            self.key_frames.append((seen.stamp, seen.garment.vertices, dict(seen.tools)))
