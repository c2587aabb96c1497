"""Pictures side by side, with true (rings) and found (crosses) key points."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.photographs.judge import Judgement
from benchmarks.photographs.photograph import Photograph

TILE = (400, 300)
COLUMNS = 4
TRUE, FOUND, TEXT = (0, 220, 0), (255, 0, 255), (0, 0, 255)


def tile(photograph: Photograph, judgement: Judgement | None = None) -> np.ndarray:
    """One picture (blue first), with the key points and a line of text."""
    scale = np.array(TILE) / [photograph.camera.width, photograph.camera.height]
    drawn = cv2.resize(photograph.picture[..., ::-1], TILE, interpolation=cv2.INTER_AREA)
    for point in photograph.truth["keypoints_px"].values():
        cv2.circle(drawn, _pixel(point, scale), 4, TRUE, 1, cv2.LINE_AA)
    text = f"{photograph.seed} {photograph.garment.template}"
    if judgement is not None:
        for point in judgement.found_px.values():
            cv2.drawMarker(drawn, _pixel(point, scale), FOUND, cv2.MARKER_TILTED_CROSS, 7, 1, cv2.LINE_AA)
        error = "" if judgement.error_m is None else f" {1e3 * judgement.error_m:.0f} mm"
        text += f" -> {judgement.found_category or 'refused'}{error} {judgement.confidence:.2f}"
    cv2.putText(drawn, text, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, TEXT, 1, cv2.LINE_AA)
    return np.asarray(drawn)


def sheet(tiles: list[np.ndarray]) -> np.ndarray:
    """The tiles in rows of four."""
    blank = np.zeros((TILE[1], TILE[0], 3), np.uint8)
    filled = tiles + [blank] * (-len(tiles) % COLUMNS)
    return np.vstack([np.hstack(filled[i : i + COLUMNS]) for i in range(0, len(filled), COLUMNS)])


def _pixel(point: list[float], scale: np.ndarray) -> tuple[int, int]:
    u, v = np.array(point) * scale
    return round(float(np.clip(u, -1e4, 1e4))), round(float(np.clip(v, -1e4, 1e4)))
