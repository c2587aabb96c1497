"""Gaps between limbs that touch further out are opened; a print of the ground's colour is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.segmentation.gaps import opened_gaps
from foldcell.skills.perception.segmentation.mask import Segmentation, filled

SIZE = (320, 420)
GROUND, CLOTH = (150, 140, 120), (60, 80, 170)
TROUSERS = np.array([[60, 100], [60, 220], [380, 230], [380, 90]])
GAP = np.array([[150, 160], [380, 154], [380, 166]])
TOUCHING = np.array([[250, 140], [275, 140], [275, 180], [250, 180]])
SPOT = np.array([[110, 150], [135, 150], [135, 175], [110, 175]])


def photographed(*patches: tuple[np.ndarray, tuple[int, int, int]]) -> tuple[np.ndarray, Segmentation]:
    """A picture of trousers with patches on them, and its segmentation, in which holes are filled."""
    rgb = np.full((*SIZE, 3), GROUND, np.uint8)
    for polygon, colour in ((TROUSERS, CLOTH), *patches):
        cv2.fillPoly(rgb, [polygon], colour)
    mask = filled((rgb == CLOTH).all(axis=2))
    (contour,), _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    noise = np.random.default_rng(0).normal(0, 3, rgb.shape)
    noisy = np.clip(rgb + noise, 0, 255).astype(np.uint8)
    return noisy, Segmentation(mask, contour.reshape(-1, 2).astype(float), 1.0, np.zeros(SIZE, bool))


def test_the_gap_above_the_place_where_the_legs_touch_is_opened() -> None:
    rgb, found = photographed((GAP, GROUND), (TOUCHING, CLOTH))
    assert found.mask[160, 200], "filled, because the legs touch at the knees"
    gapped = opened_gaps(found, rgb, np.ones(SIZE, bool))
    assert gapped is not None and not gapped.mask[160, 215:245].any()
    before, after = (np.linalg.norm(each.contour - (215, 160), axis=1).min() for each in (found, gapped))
    assert after < 5 < 30 < before, "the outline runs along the gap"
    assert np.count_nonzero(gapped.mask ^ found.mask) < 0.05 * np.count_nonzero(found.mask)


@pytest.mark.parametrize("patches", [(), ((SPOT, GROUND),)], ids=["plain", "a spot of the ground's colour"])
def test_without_a_long_narrow_gap_nothing_is_opened(
    patches: tuple[tuple[np.ndarray, tuple[int, int, int]]],
) -> None:
    rgb, found = photographed(*patches)
    assert opened_gaps(found, rgb, np.ones(SIZE, bool)) is None
