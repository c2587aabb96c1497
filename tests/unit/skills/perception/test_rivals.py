"""Which categories an outline may belong to, if no garment is named."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.skills.perception.outline import resample_closed
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.rivals import astray, likely_matches, places_of, second_best
from tests.scenes import TABLE, camera, place

GARMENTS = [load_garment(name) for name in list_garments()]
NARROW_SKIRT = np.array([
    [-0.28, -0.15], [0.0, -0.185], [0.28, -0.17], [0.275, 0.0], [0.28, 0.17], [0.0, 0.185], [-0.28, 0.15],
])  # fmt: skip
"""A skirt that is narrower at the hem than at the hip: a vest without armholes would fit it."""


def seen(polygon: np.ndarray) -> np.ndarray:
    return resample_closed(place(polygon, 0.1, 0.2, 0.7), 0.004)


@pytest.mark.parametrize("name", ["t_shirt", "long_sleeve_shirt_small", "vest", "pants", "shorts", "skirt"])
def test_a_template_resembles_its_own_category_most(name: str) -> None:
    garment = load_garment(name)
    assert (
        likely_matches(seen(np.asarray(garment.template)), GARMENTS, False)[0].garment.category == garment.category
    )


def test_a_garment_without_armpits_is_no_vest_and_one_with_armpits_is_no_skirt() -> None:
    matches = likely_matches(seen(NARROW_SKIRT), GARMENTS, False)
    assert {match.garment.category for match in matches} == {"skirt", "towel"}
    vest = likely_matches(seen(np.asarray(load_garment("vest").template)), GARMENTS, False)
    assert {"skirt", "towel"}.isdisjoint(match.garment.category for match in vest)


def test_the_second_best_is_of_another_category_and_less_alike() -> None:
    matches = likely_matches(seen(np.asarray(load_garment("medium_towel").template)), GARMENTS, False)
    second = second_best(matches, matches[0])
    assert matches[0].garment.category == "towel" and second is not None
    assert second.category == "skirt" and second.behind > 0.01
    assert second_best(matches[:1], matches[0]) is None


def test_a_key_point_out_of_view_is_the_missing_one_and_else_the_one_off_the_outline() -> None:
    shirt = load_garment("t_shirt")
    outline = place(np.asarray(shirt.template), 0.6, 0.0, 0.0)
    places = dict(zip(shirt.keypoints, outline, strict=True))
    view = TableView(camera(), TABLE)
    moved = {**places, "hem_left": places["hem_left"] + (0.0, 0.04)}
    assert astray(moved, outline, view) == "hem_left"
    assert astray({**moved, "collar_right": np.array([5.0, 0.0])}, outline, view) == "collar_right"


@pytest.mark.parametrize("name", ["medium_towel", "vest"])
def test_key_points_are_expected_where_the_garment_has_them(name: str) -> None:
    garment = load_garment(name)
    outline = seen(np.asarray(garment.template))
    (match, *_) = likely_matches(outline, [garment], True)
    expected = places_of(match.garment, outline)
    assert set(expected) == set(garment.keypoints)
    turned = place(np.asarray(garment.template), 0.1, 0.2, 0.7)
    distances = [np.linalg.norm(turned - p, axis=1).min() for p in expected.values()]
    assert max(distances) < 0.03
