"""Height maps: equal places and heights have equal colours."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from cell.recording.report.height_map import PAPER, height_maps


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
    h, w = before.shape[:2]
    assert (before[0, 0] == PAPER).all()
    assert (before[h // 2, w // 2] == after[h // 2, w // 2]).all(), "what was not pressed looks as it did"
    crease = int(w * (12 + 15) / (145 + 24))
    red, blue = before[h // 2, crease, 0], before[h // 2, crease, 2]
    assert red > 100 and blue < 60, "the highest is red"
    assert (after[h // 2, crease] == after[h // 2, w // 2]).all()


def test_unseen_parts_of_a_height_map_are_white() -> None:
    mask = np.zeros((100, 100), bool)
    mask[20:80, 20:80] = True
    height = np.where(mask, 0.02, 0.0)
    height[30:60, 30:60] = np.nan
    (picture,) = height_maps([seen(height, mask)])  # type: ignore[list-item]
    h, w = picture.shape[:2]
    assert (picture[h * 37 // 84, w * 37 // 84] == PAPER).all()
