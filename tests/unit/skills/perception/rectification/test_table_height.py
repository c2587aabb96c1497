"""The measured height of the empty table, with missing depth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.rectification.heights import height_above, table_height
from foldcell.skills.perception.rectification.table_view import RectifiedView

SHAPE = (425, 600)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
BIAS, SLOPE = -0.004, 1e-6


def biased() -> np.ndarray:
    """The table's height as measured by a camera that sees it 4 mm too low and slightly tilted [m]."""
    return (BIAS + SLOPE * (COLUMNS - 300)).astype(np.float32)


def view(height: np.ndarray) -> RectifiedView:
    return RectifiedView(np.zeros((*SHAPE, 3), np.uint8), height.astype(np.float32), np.ones(SHAPE, bool))


@pytest.mark.parametrize("radius", [1, 4, 12, 40])
def test_a_hole_in_the_empty_tables_depth_adds_no_height(radius: int) -> None:
    empty = biased()
    empty[np.hypot(ROWS - 200, COLUMNS - 260) < radius] = np.nan
    assert np.abs(height_above(view(biased()), view(empty))).max() < 0.0001


def test_single_pixels_without_depth_and_a_strip_beyond_the_picture_change_nothing() -> None:
    empty = biased()
    empty[np.random.default_rng(0).random(SHAPE) < 0.05] = np.nan
    empty[:, :70] = np.nan
    height = height_above(view(biased()), view(empty))
    assert np.abs(height[:, 70:]).max() < 0.00002 and np.abs(height).max() < 0.0001


def test_a_table_without_holes_is_its_blurred_depth_bit_for_bit() -> None:
    empty = biased() + np.random.default_rng(1).normal(0.0, 0.0015, SHAPE).astype(np.float32)
    coarse = cv2.GaussianBlur(cv2.resize(empty, (150, 106), interpolation=cv2.INTER_AREA), (0, 0), 1.0)
    assert np.array_equal(table_height(empty), cv2.resize(coarse, SHAPE[::-1], interpolation=cv2.INTER_LINEAR))


def test_a_table_without_depth_has_zero_height() -> None:
    nothing = np.full(SHAPE, np.nan, np.float32)
    assert not table_height(nothing).any()
    nothing[7, 9] = BIAS
    assert np.allclose(table_height(nothing), BIAS, atol=1e-5)
