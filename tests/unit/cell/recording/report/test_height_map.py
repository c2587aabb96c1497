"""Height maps: equal places and heights have equal colours."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np

from cell.recording.report.height_map import BAR, PAPER, height_maps


def seen(height: np.ndarray, mask: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(height=height.astype(np.float32), mask=mask)


def test_pictures_of_one_fold_share_their_part_of_the_table_and_their_colours() -> None:
    mask = np.zeros((200, 300), bool)
    mask[60:120, 80:220] = True
    other = np.roll(mask, 5, axis=1)
    high, low = np.where(mask, 0.02, 0.0), np.where(other, 0.02, 0.0)
    high[60:120, 80:110] = 0.04  # a crease, which is pressed
    before, after = height_maps([seen(high, mask), seen(low, other)])  # type: ignore[list-item]
    assert before.shape == after.shape and before.shape[1] >= 420
    h, w = before.shape[0] - BAR, before.shape[1]
    assert (before[0, 0] == PAPER).all()
    assert (before[h // 2, w // 2] == after[h // 2, w // 2]).all(), "what was not pressed looks as it did"
    crease = int(w * (12 + 15) / (145 + 24))
    highest, flat = before[h // 2, crease].astype(int), before[h // 2, w // 2].astype(int)
    assert highest.sum() > flat.sum() + 50, "higher places are lighter"
    assert (before[h + BAR // 2] == highest).all(axis=1).any(), "the bar shows the colour of the highest place"
    assert (after[h // 2, crease] == after[h // 2, w // 2]).all()


def test_unseen_parts_of_a_height_map_are_white() -> None:
    mask = np.zeros((100, 100), bool)
    mask[20:80, 20:80] = True
    height = np.where(mask, 0.02, 0.0)
    height[30:60, 30:60] = np.nan
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    h, w = picture.shape[0] - BAR, picture.shape[1]
    assert (picture[h * 37 // 84, w * 37 // 84] == PAPER).all()


def test_equal_steps_of_height_are_equal_steps_of_lightness() -> None:
    mask = np.ones((300, 1001), bool)
    height = np.broadcast_to(np.linspace(0.0, 0.02, 1001), mask.shape)
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    lightness = cv2.cvtColor(picture[100:101], cv2.COLOR_RGB2LAB)[0, 30:-30, 0].astype(float)
    steps = np.diff(lightness[:: len(lightness) // 8])
    assert (steps > 0).all() and steps.max() < 1.6 * steps.min()
