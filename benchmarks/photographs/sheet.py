"""Pictures side by side, with true (rings) and found (crosses) key points."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from benchmarks.photographs.photograph import Photograph

TILE = (400, 300)
COLUMNS = 4
TRUE, FOUND, TEXT = (0, 220, 0), (255, 0, 255), (0, 0, 255)


def tile(photograph: Photograph, found_px: Mapping[str, list[float]], caption: str) -> np.ndarray:
    """One picture (blue first), with the key points and two lines of text. A tall picture keeps its shape."""
    camera = photograph.camera
    scale = min(TILE[0] / camera.width, TILE[1] / camera.height)
    size = (round(scale * camera.width), round(scale * camera.height))
    drawn = np.zeros((TILE[1], TILE[0], 3), np.uint8)
    drawn[: size[1], : size[0]] = cv2.resize(photograph.picture[..., ::-1], size, interpolation=cv2.INTER_AREA)
    for point in photograph.truth["keypoints_px"].values():
        cv2.circle(drawn, _pixel(point, scale), 4, TRUE, 1, cv2.LINE_AA)
    for point in found_px.values():
        cv2.drawMarker(drawn, _pixel(point, scale), FOUND, cv2.MARKER_TILTED_CROSS, 7, 1, cv2.LINE_AA)
    words = [str(photograph.seed), photograph.garment.template]
    words += [str(photograph.details[key]) for key in ("ground", "due") if photograph.details.get(key)]
    for row, text in enumerate((" ".join(words), caption)):
        for colour, width in (((255, 255, 255), 3), (TEXT, 1)):
            cv2.putText(
                drawn, text, (5, 14 + 15 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, width, cv2.LINE_AA
            )
    return drawn


def sheet(tiles: list[np.ndarray]) -> np.ndarray:
    """The tiles in rows of four."""
    blank = np.zeros((TILE[1], TILE[0], 3), np.uint8)
    filled = tiles + [blank] * (-len(tiles) % COLUMNS)
    return np.vstack([np.hstack(filled[i : i + COLUMNS]) for i in range(0, len(filled), COLUMNS)])


def _pixel(point: list[float], scale: float) -> tuple[int, int]:
    u, v = np.array(point) * scale
    return round(float(np.clip(u, -1e4, 1e4))), round(float(np.clip(v, -1e4, 1e4)))
