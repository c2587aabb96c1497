"""Drawn photographs of garments: the truth that comes with a picture fits the picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from shapely.geometry import Polygon

from benchmarks.photographs.canvas import Canvas, under
from benchmarks.photographs.clutter import GAP, scatter
from benchmarks.photographs.judge import calibration_error
from benchmarks.photographs.lens import random_camera
from benchmarks.photographs.photograph import draw, placed
from benchmarks.photographs.shapes import GARMENTS, Garment
from foldcell.cell.config.garments.garment_file import load_garment

rng_of = np.random.default_rng


@pytest.mark.parametrize("make", GARMENTS)
@pytest.mark.parametrize("seed", range(8))
def test_key_points_lie_on_the_outline_and_have_the_template_s_names(make, seed: int) -> None:
    garment: Garment = make(rng_of(seed))
    assert set(garment.keypoints) == set(load_garment(garment.template).keypoints)
    for point in garment.keypoints.values():
        assert np.linalg.norm(garment.outline - point, axis=1).min() < 1e-9
    assert Polygon(garment.outline).is_valid
    area = cv2.contourArea(garment.outline.astype(np.float32))
    assert 0.05 < area < 0.8


@pytest.mark.parametrize("tilt", [0.0, 12.0, 25.0])
def test_a_camera_s_pixels_map_back_to_the_table(tilt: float) -> None:
    garment = placed(GARMENTS[1](rng_of(1)), 0.1, np.array([0.6, 0.0]))
    camera = random_camera(rng_of(2), garment.outline, tilt, (640, 480))
    pixels = camera.pixels(garment.outline)
    assert np.all((pixels > 0) & (pixels < [640, 480]))
    assert np.allclose(camera.on_table(pixels), garment.outline, atol=1e-4)


def test_a_long_garment_is_seen_whole_by_a_narrow_lens() -> None:
    outline = np.array([[0.05, -0.3], [1.15, -0.3], [1.15, 0.3], [0.05, 0.3]])
    pixels = random_camera(rng_of(34), outline, 20.0, (1280, 720)).pixels(outline)
    assert np.all((pixels > 0) & (pixels < [1280, 720]))


def test_the_picture_shows_what_is_farther_higher_and_what_is_left_on_the_left() -> None:
    garment = placed(GARMENTS[0](rng_of(1)), 0.0, np.array([0.6, 0.0]))
    camera = random_camera(rng_of(2), garment.outline, 10.0, (640, 480))
    near, far, left = camera.pixels(np.array([[0.5, 0.0], [0.7, 0.0], [0.5, 0.1]]))
    assert far[1] < near[1]
    assert left[0] < near[0]


@pytest.mark.parametrize("gap", [0.004, 0.02])
def test_drawn_cloth_is_as_wide_as_its_outline(gap: float) -> None:
    """Otherwise the gap between two legs would end before the crotch that is stated as true."""
    canvas = Canvas((0.5, 0.25), 0.001, (500, 500))
    low, high = -0.1 - gap / 2, 0.1 + gap / 2
    cover = sum(
        canvas.mask(np.array([[0.1, a], [0.4, a], [0.4, b], [0.1, b]]))
        for a, b in ((low, -gap / 2), (gap / 2, high))
    )
    assert np.sum(1 - cover[250, 160:340]) * canvas.pixel == pytest.approx(gap, abs=0.0004)


def test_things_keep_away_from_the_garment() -> None:
    for seed in range(3):
        rng = rng_of(seed)
        garment = placed(GARMENTS[6](rng), 0.0, np.array([0.6, 0.0]))
        camera = random_camera(rng, garment.outline, 10.0, (640, 480))
        canvas = under(camera, 600)
        mask = canvas.mask(garment.outline)
        away = cv2.distanceTransform((mask == 0).astype(np.uint8), cv2.DIST_L2, 5) * canvas.pixel
        for thing in scatter(rng, canvas, camera, mask):
            cover = np.max([part[0] for part in thing], axis=0) > 0
            assert away[cover].min() > 0.9 * GAP


def test_the_same_seed_draws_the_same_picture() -> None:
    first, again = draw(12, 300), draw(12, 300)
    assert np.array_equal(first.picture, again.picture)
    assert first.truth == again.truth


def test_confidence_that_equals_the_share_of_right_answers_has_no_calibration_error() -> None:
    assert calibration_error(np.full(4, 0.75), np.array([1.0, 1.0, 1.0, 0.0])) == pytest.approx(0.0)
    assert calibration_error(np.array([0.95, 0.95]), np.zeros(2)) == pytest.approx(0.95)
