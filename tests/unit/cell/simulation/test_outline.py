"""The true outline of a garment: near its template and different from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.simulation.garment.outline import draw_outline
from foldcell.cell.simulation.noise import load_noise

NOISE = load_noise().garment
TOWELS = ("small_towel", "medium_towel", "large_towel")


@pytest.mark.parametrize("name", TOWELS)
def test_an_outline_is_a_simple_counter_clockwise_ring_of_the_garments_size(name: str) -> None:
    garment = load_garment(name)
    nominal = shapely.Polygon(garment.template)
    for seed in range(20):
        ring = shapely.LinearRing(draw_outline(garment, NOISE, np.random.default_rng(seed)).contour)
        assert ring.is_simple and ring.is_ccw
        area = shapely.Polygon(ring).area / nominal.area
        assert (1 - NOISE.size) ** 2 - 0.03 < area < (1 + NOISE.size) ** 2 + 0.03


@pytest.mark.parametrize("name", TOWELS)
def test_key_points_lie_on_the_contour_near_the_template(name: str) -> None:
    garment = load_garment(name)
    outline = draw_outline(garment, NOISE, np.random.default_rng(4))
    assert set(outline.keypoints) == set(garment.keypoints)
    ring = shapely.LinearRing(outline.contour)
    for key, point in zip(garment.keypoints, garment.template, strict=True):
        assert ring.distance(shapely.Point(outline.keypoints[key])) < 2e-3
        assert np.linalg.norm(outline.keypoints[key] - point) < 0.02


def test_corners_are_round_and_differ_between_pieces() -> None:
    garment = load_garment("medium_towel")
    one, other = (draw_outline(garment, NOISE, np.random.default_rng(s)) for s in (1, 2))
    corner = draw_outline(garment, NOISE, np.random.default_rng(1), ideal=True)
    for key, point in zip(garment.keypoints, garment.template, strict=True):
        cut = np.linalg.norm(corner.keypoints[key] - point)
        assert 0.001 < cut < 0.008  # the sharp corner is outside the cloth by (sqrt 2 - 1) of the radius
    assert np.abs(one.contour - other.contour).max() > 1e-3


def test_a_garment_without_an_outline_uses_its_template() -> None:
    garment = replace(load_garment("medium_towel"), name="somebody_elses")
    outline = draw_outline(garment, NOISE, np.random.default_rng(0), ideal=True)
    distance = shapely.LinearRing(outline.contour).hausdorff_distance(shapely.LinearRing(garment.template))
    assert distance < 0.005


def test_a_user_garment_with_any_name_can_be_laid() -> None:
    garment = load_garment("t_shirt")
    smaller = replace(garment, template=0.8 * garment.template)
    outline = draw_outline(smaller, NOISE, np.random.default_rng(0), ideal=True)
    assert np.ptp(outline.contour, axis=0) == pytest.approx(0.8 * np.array(garment.size_m), abs=0.01)
    assert set(outline.keypoints) == set(garment.keypoints)
