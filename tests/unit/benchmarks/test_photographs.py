"""Drawn photographs of garments: the truth that comes with a picture fits the picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from shapely.geometry import Polygon

from benchmarks.photographs.canvas import Canvas, under
from benchmarks.photographs.clutter import GAP, scatter
from benchmarks.photographs.judge import TRUE_REASONS, calibration_error
from benchmarks.photographs.lens import random_camera
from benchmarks.photographs.phone.garments import CATEGORIES, garment
from benchmarks.photographs.phone.grounds import GROUNDS
from benchmarks.photographs.phone.photograph import CAUSES, draw, phone, taken
from benchmarks.photographs.phone.relief import Light, lit
from benchmarks.photographs.real.photograph import place
from foldcell.cell.config.garments.garment_file import load_garment

rng_of = np.random.default_rng
SHIPPED = {"long_sleeve_shirt": "long_sleeve_shirt_small", "towel": "medium_towel"}
OUTLINE = place(garment(rng_of(1), ("t_shirt",)), 0.1, np.array([0.6, 0.0])).outline


@pytest.mark.parametrize("category", CATEGORIES)
def test_key_points_lie_on_the_outline_in_the_template_s_order(category: str) -> None:
    template = load_garment(SHIPPED.get(category, category)).keypoints
    for seed in range(12):
        whole = garment(rng_of(seed), (category,))
        assert Polygon(whole.outline).is_valid
        assert set(whole.keypoints) == set(template)
        assert Polygon([whole.keypoints[key] for key in template]).exterior.is_ccw
        assert 0.04 < cv2.contourArea(whole.outline.astype(np.float32)) < 1.2


@pytest.mark.parametrize("tilt", [0.0, 12.0, 25.0])
@pytest.mark.parametrize("roll", [0.0, 90.0, 187.0])
def test_a_camera_s_pixels_map_back_to_the_table(tilt: float, roll: float) -> None:
    camera = replace(random_camera(rng_of(2), OUTLINE, tilt, (640, 480)), roll_deg=roll)
    pixels = camera.pixels(OUTLINE)
    assert roll or np.all((pixels > 0) & (pixels < [640, 480]))
    assert np.allclose(camera.on_table(pixels), OUTLINE, atol=1e-4)


def test_a_long_garment_is_seen_whole_by_a_narrow_lens() -> None:
    outline = np.array([[0.05, -0.3], [1.15, -0.3], [1.15, 0.3], [0.05, 0.3]])
    pixels = random_camera(rng_of(34), outline, 20.0, (1280, 720)).pixels(outline)
    assert np.all((pixels > 0) & (pixels < [1280, 720]))
    for seed in range(20):
        camera = phone(rng_of(seed), outline)
        pixels = camera.pixels(outline)
        assert np.all((pixels > 0) & (pixels < [camera.width, camera.height]))
        down = np.array([0.0, 0.0, -1.0])
        assert camera.axes[2] @ down > np.cos(np.radians(15.01))


def test_the_picture_shows_what_is_farther_higher_and_what_is_left_on_the_left() -> None:
    camera = random_camera(rng_of(2), OUTLINE, 10.0, (640, 480))
    ahead, aside = np.array([[0.5, 0.0], [0.7, 0.0]]), np.array([[0.5, 0.0], [0.5, 0.1]])
    assert np.diff(camera.pixels(ahead)[:, 1]) < 0 and np.diff(camera.pixels(aside)[:, 0]) < 0
    turned = replace(camera, roll_deg=90.0)  # clockwise: what is far is on the left of the picture
    assert np.diff(turned.pixels(ahead)[:, 0]) < 0


def test_what_lies_at_a_point_of_the_canvas_is_seen_at_its_pixel() -> None:
    camera = replace(random_camera(rng_of(2), OUTLINE, 14.0, (640, 480)), k1=0.0, roll_deg=93.0)
    canvas = under(camera, 900)
    spot = np.array([[0.52, 0.07]])
    column, row = np.round(canvas.at(spot)[0]).astype(int)
    drawn = np.full((*canvas.shape, 3), 0.02, np.float32)
    cv2.circle(drawn, (int(column), int(row)), 5, (0.9, 0.9, 0.9), -1)
    shown = taken(rng_of(3), drawn, canvas, camera).mean(axis=2)
    rows, columns = np.nonzero(shown > shown.max() / 2)
    assert np.allclose([columns.mean(), rows.mean()], camera.pixels(spot)[0], atol=1.0)


def test_a_slope_towards_the_lamp_is_bright_and_a_step_throws_its_shadow_away_from_it() -> None:
    canvas = Canvas((0.1, 0.1), 0.001, (200, 200))
    lamp = Light("sun", ((-np.sqrt(0.5), 0.0, np.sqrt(0.5)),), 0.0)  # from the left, 45 degrees high
    flat = np.zeros(canvas.shape, np.float32)
    assert np.allclose(lit(flat, canvas, lamp), 1.0)
    rising = np.tile(np.arange(200, dtype=np.float32) * 0.0002, (200, 1))  # to the right: it faces the lamp
    assert lit(rising, canvas, lamp)[100, 100] > 1.1 > 0.9 > lit(-rising, canvas, lamp)[100, 100]
    flat[:, 80:100] = 0.02
    dark = lit(flat, canvas, lamp)[100] < 0.3
    assert not dark[60:78].any() and dark[104:116].all() and not dark[124:].any()


def test_every_fourth_picture_is_due_to_be_refused_and_each_cause_has_a_true_reason() -> None:
    assert set(CAUSES) <= set(TRUE_REASONS)
    for seed, due in ((4, "folded"), (24, "body"), (28, "print"), (5, None)):
        drawn = draw(seed, 200)
        assert drawn.details["due"] == due
        assert bool(drawn.garment.keypoints) == (due is None)
        assert drawn.mask.any() == (due not in ("body", "print"))


def test_every_ground_fills_the_canvas() -> None:
    canvas = Canvas((0.5, 0.4), 0.004, (160, 200))
    for name, ground in GROUNDS.items():
        colours, height = ground(rng_of(1), canvas)
        assert colours.shape == (160, 200, 3) and height.shape == (160, 200), name
        assert np.isfinite(colours).all() and np.abs(height).max() < 0.04, name


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
        camera = random_camera(rng, OUTLINE, 10.0, (640, 480))
        canvas = under(camera, 600)
        mask = canvas.mask(OUTLINE)
        away = cv2.distanceTransform((mask == 0).astype(np.uint8), cv2.DIST_L2, 5) * canvas.pixel
        for thing in scatter(rng, canvas, camera, mask):
            cover = np.max([part[0] for part in thing], axis=0) > 0
            assert away[cover].min() > 0.9 * GAP


def test_the_same_seed_draws_the_same_picture_and_its_key_points_lie_on_the_cloth() -> None:
    first, again = draw(61, 300), draw(61, 300)
    cover = cv2.dilate(first.mask, np.ones((3, 3)))
    for column, row in np.round(first.canvas.at(np.array(list(first.garment.keypoints.values())))).astype(int):
        assert cover[row, column] > 0
    assert np.array_equal(first.picture, again.picture)
    assert first.truth == again.truth


def test_confidence_that_equals_the_share_of_right_answers_has_no_calibration_error() -> None:
    assert calibration_error(np.full(4, 0.75), np.array([1.0, 1.0, 1.0, 0.0])) == pytest.approx(0.0)
    assert calibration_error(np.array([0.95, 0.95]), np.zeros(2)) == pytest.approx(0.95)
