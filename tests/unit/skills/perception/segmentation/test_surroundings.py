"""What is seen just outside an outline: the ground on every side, or the rest of a garment."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.segmentation.mask import Segmentation
from foldcell.skills.perception.segmentation.surroundings import MOST_FOREIGN, foreign_stretch

SIZE = (300, 400)
SHIRT = np.array([[70, 40], [330, 40], [370, 130], [330, 190], [290, 160], [290, 270], [110, 270], [110, 160],
                  [70, 190], [30, 130]])  # fmt: skip
BODY = np.array([[110, 40], [290, 40], [290, 270], [110, 270]])
PRINT = np.array([[150, 100], [250, 100], [250, 200], [150, 200]])


def ground(pattern: str) -> np.ndarray:
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    ground = np.full((*SIZE, 3), (170.0, 160.0, 150.0))
    if pattern == "checks":
        ground[(rows // 20 + columns // 20) % 2 == 0] = (90, 120, 170)
    if pattern == "light from one side":
        ground *= (0.7 + 0.5 * columns / SIZE[1])[..., None]
    return ground


def outlined(polygon: np.ndarray) -> Segmentation:
    mask = cv2.fillPoly(np.zeros(SIZE, np.uint8), [polygon.astype(np.int32)], 1)
    (contour,), _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return Segmentation(mask > 0, contour.reshape(-1, 2).astype(float), 1.0, np.zeros(SIZE, bool))


@pytest.mark.parametrize("pattern", ["plain", "checks", "light from one side"])
@pytest.mark.parametrize(
    ("polygon", "surrounded"), [(SHIRT, True), (BODY, False), (PRINT, False)], ids=["shirt", "body", "print"]
)
def test_only_a_whole_garment_is_surrounded_by_the_ground(
    pattern: str, polygon: np.ndarray, surrounded: bool
) -> None:
    rgb = ground(pattern)
    cv2.fillPoly(rgb, [SHIRT.astype(np.int32)], (40, 60, 50))
    cv2.fillPoly(rgb, [PRINT.astype(np.int32)], (220, 70, 150))
    rgb = np.clip(rgb + np.random.default_rng(0).normal(0, 2, rgb.shape), 0, 255).astype(np.uint8)
    share, _ = foreign_stretch(rgb, np.ones(SIZE, bool), outlined(polygon))
    assert (share <= MOST_FOREIGN) == surrounded


def test_the_side_on_which_cloth_continues_is_told() -> None:
    rgb = ground("plain")
    cv2.fillPoly(rgb, [np.array([[100, 80], [380, 80], [380, 220], [100, 220]], np.int32)], (40, 60, 50))
    left_half = np.array([[100, 80], [240, 80], [240, 220], [100, 220]])
    share, (column, row) = foreign_stretch(rgb.astype(np.uint8), np.ones(SIZE, bool), outlined(left_half))
    assert share == pytest.approx(0.25, abs=0.04)
    assert abs(column - 240) < 4 and abs(row - 150) < 12
