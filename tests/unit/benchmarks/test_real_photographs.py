"""The real set of photographs: its truth fits its pictures, and its judge counts what it says."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from shapely.geometry import Polygon

from benchmarks.photographs import judge as judging
from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.judge import Judgement
from benchmarks.photographs.real.grounds import GROUNDS
from benchmarks.photographs.real.outlines import MOST, bases, flat, mirrored, warped
from benchmarks.photographs.real.photograph import CATEGORIES, CAUSES, draw, other_garment, place, white_cloth
from benchmarks.photographs.real.spoilt import bunched_sleeve, folded_in_half, heap
from benchmarks.photographs.real.things import NEAR, surround
from foldcell.cell.config.garments.garment_file import load_garment

rng_of = np.random.default_rng
SHIPPED = {"long_sleeve_shirt": "long_sleeve_shirt_small", "towel": "medium_towel"}


@pytest.mark.parametrize("name", bases())
def test_key_points_lie_on_the_warped_outline_in_the_template_s_order(name: str) -> None:
    base = bases()[name]
    template = load_garment(SHIPPED.get(base.category, base.category)).keypoints
    for seed in range(3):
        whole = warped(rng_of(seed), flat(base, 0.004))
        assert Polygon(whole.outline).is_valid
        assert set(whole.keypoints) == set(template)
        for point in whole.keypoints.values():
            assert np.linalg.norm(whole.outline - point, axis=1).min() == 0.0
        ring = Polygon([whole.keypoints[key] for key in template])
        assert ring.exterior.is_ccw  # as the template's, so that right and left are not exchanged


@pytest.mark.parametrize("name", bases())
def test_a_warp_keeps_each_measure_within_its_bounds(name: str) -> None:
    whole = flat(bases()[name])
    for seed in range(3):
        ratio = np.ptp(warped(rng_of(seed), whole).outline, axis=0) / np.ptp(whole.outline, axis=0)
        assert ratio.min() > 1 - MOST - 0.1
        assert ratio.max() < 1 + 2 * MOST + 0.1  # scale and taper at the hem, and waves


def test_the_traced_marks_stand_where_the_outline_was_marked() -> None:
    base = bases()["t_shirt_2"]
    found = flat(base).keypoints
    assert np.allclose(found["collar_left"], base.points[15], atol=0.003)
    between = 0.3 * base.points[9] + 0.7 * base.points[10]
    assert np.linalg.norm(found["shoulder_right"] - between) < 0.006
    assert found["cuff_upper_left"][1] > 0.2  # y to the left


def test_a_mirrored_garment_has_its_sides_exchanged() -> None:
    whole = flat(bases()["pants_1"])
    other = mirrored(whole)
    assert np.allclose(other.keypoints["waist_near"], whole.keypoints["waist_far"] * [1, -1])
    assert np.allclose(other.keypoints["crotch"], whole.keypoints["crotch"] * [1, -1])


def test_the_same_seed_draws_the_same_picture_and_its_truth_lies_on_the_cloth() -> None:
    first, again = draw(8031, 300), draw(8031, 300)
    assert np.array_equal(first.picture, again.picture)
    assert first.truth == again.truth
    drawn = next(p for p in (draw(seed, 200) for seed in range(8000, 8010)) if p.details["due"] is None)
    cover = cv2.dilate(drawn.mask, np.ones((3, 3)))
    for column, row in np.round(drawn.canvas.at(np.array(list(drawn.garment.keypoints.values())))).astype(int):
        assert cover[row, column] > 0
    pixels = np.array(list(drawn.truth["keypoints_px"].values()))
    assert np.all((pixels > 0) & (pixels < [drawn.camera.width, drawn.camera.height]))


def test_every_ground_fills_the_canvas() -> None:
    canvas = Canvas((0.5, 0.4), 0.004, (160, 200))
    for name, ground in GROUNDS.items():
        drawn = ground(rng_of(1), canvas)
        assert drawn.shape == (160, 200, 3), name
        assert np.isfinite(drawn).all(), name


def test_a_spoilt_garment_covers_less_of_the_ground_than_a_flat_one() -> None:
    whole = place(warped(rng_of(2), flat(bases()["shirt_spread"], 0.004)), 0.2, np.array([0.6, 0.0]))
    area = Polygon(whole.outline).area
    for make, most in ((folded_in_half, 0.7), (heap, 0.6), (bunched_sleeve, 0.98)):
        for seed in range(4):
            layers = make(rng_of(seed), whole)
            assert len(layers) > 1
            covered = Polygon(layers[0]).buffer(0)
            for layer in layers[1:]:
                covered = covered.union(Polygon(layer).buffer(0))
            assert 0.1 * area < covered.area < most * area, make.__name__


def test_two_garments_always_lie_on_eachother_garment() -> None:
    whole = place(flat(bases()["shirt_spread"]), 0.0, np.array([0.6, 0.0]))
    body = Polygon(whole.outline)
    for seed in range(12):
        other = Polygon(other_garment(rng_of(seed), whole).outline)
        assert body.intersection(other).area > 0.05 * body.area


def test_things_lie_near_the_garment_and_never_on_it() -> None:
    canvas = Canvas((0.6, 0.5), 0.005, (240, 200))
    garment = canvas.mask(np.array([[0.1, -0.1], [-0.2, -0.1], [-0.2, 0.1], [0.1, 0.1]]))
    away = cv2.distanceTransform((garment <= 0).astype(np.uint8), cv2.DIST_L2, 5) * canvas.pixel
    things = surround(rng_of(3), canvas, garment)
    assert things
    for thing in things:
        assert away[np.max([part[0] for part in thing], axis=0) > 0].min() > 0.8 * NEAR


def test_white_cloth_is_hard_to_tell_from_white_ground_but_not_impossible() -> None:
    ground = np.float32([0.85, 0.86, 0.86])
    assert all(0.0 < np.abs(white_cloth(rng_of(s), ground) - ground).max() < 0.2 for s in range(20))


def test_every_category_has_an_outline_and_every_cause_a_true_reason() -> None:
    assert {base.category for base in bases().values()} == set(CATEGORIES)
    assert set(CAUSES) <= set(judging.TRUE_REASONS)


def judgement(**given: object) -> Judgement:
    plain = Judgement(
        seed=1, category="t_shirt", due=None, stated=True, ground="bed", outline="polo", accepted=True,
        found_category="t_shirt", confidence=1.0, error=0.01, worst_keypoint="neck", found_px={},
        failure_kind=None, failure=None, seconds=1.0, details={},
    )  # fmt: skip
    return replace(plain, **given)  # type: ignore[arg-type]


def test_the_figures_count_right_far_wrong_and_refused_pictures() -> None:
    refusal = {"accepted": False, "found_category": None, "error": None, "confidence": 0.0}
    figures = judging.figures(
        [
            judgement(),
            judgement(error=0.03),
            judgement(error=0.07, confidence=0.0),
            judgement(stated=False, found_category="towel", error=None, confidence=0.0),
            judgement(**refusal, failure_kind="low_confidence"),
            judgement(**refusal, due="cut", failure_kind="out_of_view"),
            judgement(**refusal, due="heap", failure_kind="unknown_garment"),
            judgement(due="none", error=None, confidence=0.0),
        ]
    )
    assert figures["accepted_share"] == pytest.approx(0.8)
    assert figures["right_share_of_accepted"] == pytest.approx(0.25)
    assert figures["beyond_6_percent"] == 1
    assert figures["wrong_categories"] == figures["auto_wrong_category"] == 1
    assert figures["accepted_though_due_to_be_refused"] == 1
    assert figures["true_reason_share"] == pytest.approx(1 / 3)
    assert figures["calibration_error"] == pytest.approx(0.2)  # one of five is sure and more than 2 % off
