"""Draw all outlines with their marked key points: `python -m benchmarks.photographs.real.marks FILE`."""

from __future__ import annotations

import sys

import cv2
import numpy as np

from benchmarks.photographs.real.outlines import Flat, bases, flat

TILE, MARGIN, COLUMNS = 360, 34, 6
CLOTH, EDGE, MARK, TEXT = (235, 225, 210), (0, 0, 0), (0, 0, 255), (150, 0, 0)


def drawn(whole: Flat) -> np.ndarray:
    """The outline from the collar's side up, its key points, and the first letters of their names."""
    tile = np.full((TILE, TILE, 3), 255, np.uint8)
    high = whole.outline.max(axis=0)
    scale = (TILE - 2 * MARGIN) / np.ptp(whole.outline, axis=0).max()

    def pixels(points: np.ndarray) -> np.ndarray:
        return np.round(((high - points) * scale + MARGIN)[:, ::-1]).astype(np.int32)

    cv2.fillPoly(tile, [pixels(whole.outline)], CLOTH, cv2.LINE_AA)
    cv2.polylines(tile, [pixels(whole.outline)], True, EDGE, 1, cv2.LINE_AA)
    for name, point in whole.keypoints.items():
        column, row = map(int, pixels(point[None])[0])
        cv2.circle(tile, (column, row), 3, MARK, -1, cv2.LINE_AA)
        label = " ".join(word[:2] for word in name.split("_"))
        cv2.putText(tile, label, (column + 4, row - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.32, TEXT, 1, cv2.LINE_AA)
    cv2.putText(tile, whole.base, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, EDGE, 1, cv2.LINE_AA)
    return tile


def main() -> int:
    tiles = [drawn(flat(base, 0.003)) for base in bases().values()]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    return 0 if cv2.imwrite(sys.argv[1], np.vstack(rows), [cv2.IMWRITE_WEBP_QUALITY, 60]) else 1


if __name__ == "__main__":
    raise SystemExit(main())
