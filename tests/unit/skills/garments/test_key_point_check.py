"""Key points that a person has placed: right ones pass, and each kind of mistake is found and named."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.key_point_check import KeyPointFinding, check_key_points
from foldcell.skills.garments.picture_measure import PictureMeasure
from tests.scenes import place

GARMENTS = {name: load_garment(name) for name in list_garments()}
COLUMNS, ROWS = 1280, 960
Points = dict[str, np.ndarray]


def placed(garment: Garment, angle: float = 0.2, scale: float = 500.0) -> Points:
    """The key points in a picture from above, with the laid garment turned by `angle`. scale [px/m]."""
    xy = place(garment.template, 0.0, 0.0, angle)
    pixels = np.array([COLUMNS / 2, ROWS / 2]) - scale * xy[:, ::-1]
    return dict(zip(garment.keypoints, pixels, strict=True))


def measure(garment: Garment, length: float | None = None) -> PictureMeasure:
    if length is None:
        length = float(np.linalg.norm(garment.template[0] - garment.template[1]))
    return PictureMeasure(COLUMNS, ROWS, (0, 1), length)


def check(garment: Garment, points: Points, **more: np.ndarray) -> tuple[KeyPointFinding, ...]:
    return check_key_points(points, garment, measure(garment), **more)


def pairs(garment: Garment) -> list[tuple[str, str]]:
    """Left and right, or near and far where no name has a side."""
    for a, b in (("left", "right"), ("near", "far")):
        found = [(n, n.replace(a, b)) for n in garment.keypoints if a in n]
        if found:
            return found
    raise AssertionError(garment.name)


def exchanged(points: Points, names: list[tuple[str, str]]) -> Points:
    swapped = dict(points)
    for a, b in names:
        swapped[a], swapped[b] = points[b], points[a]
    return swapped


garments = st.sampled_from(list(GARMENTS.values()))
angles = st.floats(-np.pi, np.pi)


@given(garments, angles, st.integers(0, 2**32 - 1))
def test_right_key_points_pass_in_any_direction(garment: Garment, angle: float, seed: int) -> None:
    """A hand places them to a pixel or two, and no garment is quite like another."""
    noise = np.random.default_rng(seed).normal(0.0, 2.0, (len(garment.keypoints), 2))
    points = {name: p + e for (name, p), e in zip(placed(garment, angle).items(), noise, strict=True)}
    assert check(garment, points) == ()


@given(garments, angles, st.data())
def test_exchanged_sides_are_found_and_named(garment: Garment, angle: float, data: st.DataObject) -> None:
    every = pairs(garment)
    subsets = [c for n in range(1, len(every) + 1) for c in combinations(every, n)]
    names = list(data.draw(st.sampled_from(subsets)))
    (finding,) = check(garment, exchanged(placed(garment, angle), names))
    assert finding.refused and "exchanged" in finding.what
    symmetric_both_ways = garment.category == "towel"  # its two halves can be told apart in two ways
    if not symmetric_both_ways:
        assert set(finding.names) == {name for pair in names for name in pair}


def test_a_towel_whose_near_and_far_corners_are_exchanged_on_one_side() -> None:
    towel = GARMENTS["small_towel"]
    (finding,) = check(towel, exchanged(placed(towel), [("near_left", "far_left")]))
    assert finding.refused and "near and far are exchanged" in finding.what


def test_missing_and_unknown_names_and_places_off_the_picture_are_found_together() -> None:
    skirt = GARMENTS["skirt"]
    points = placed(skirt) | {"belly": np.zeros(2), "hem_left": np.array([640.0, ROWS])}
    del points["hem_right"]
    missing, unknown, outside = check(skirt, points)
    assert (missing.names, unknown.names, outside.names) == (("hem_right",), ("belly",), ("hem_left",))
    assert "960 rows" in outside.hint and all(f.refused for f in (missing, unknown, outside))


def test_an_edge_that_crosses_another_one_is_named() -> None:
    shirt = GARMENTS["t_shirt"]
    points = exchanged(placed(shirt), [("armpit_left", "shoulder_left")])
    (finding,) = check(shirt, points)
    assert finding.refused and "crosses itself" in finding.what and "armpit_left" in finding.names


def test_two_key_points_at_one_place_are_named() -> None:
    shirt = GARMENTS["t_shirt"]
    points = placed(shirt)
    (finding,) = check(shirt, points | {"collar_left": points["collar_right"]})
    assert finding.refused and set(finding.names) == {"collar_left", "collar_right"}


def test_other_proportions_are_a_doubt_with_the_worst_edge() -> None:
    shirt = GARMENTS["t_shirt"]
    points = placed(shirt)
    near = 0.97 * points["hem_left"] + 0.03 * points["armpit_left"]
    (finding,) = check(shirt, points | {"armpit_left": near})
    assert not finding.refused and finding.names == ("armpit_left", "hem_left")


def test_other_proportions_do_not_hide_an_impossible_size() -> None:
    shirt = GARMENTS["t_shirt"]
    points = placed(shirt)
    points["armpit_left"] = 0.97 * points["hem_left"] + 0.03 * points["armpit_left"]
    proportions, size = check_key_points(points, shirt, measure(shirt, 20.0))
    assert not proportions.refused and size.refused and "is possible" in size.what


@pytest.mark.parametrize(
    ("factor", "refused"), [(1.3, None), (3.0, False), (0.3, False), (20.0, True), (0.02, True)]
)
def test_an_absurd_size_is_found(factor: float, refused: bool | None) -> None:
    """refused: whether no garment can be made; None: nothing is found."""
    vest = GARMENTS["vest"]
    length = factor * float(np.linalg.norm(vest.template[0] - vest.template[1]))
    found = check_key_points(placed(vest), vest, measure(vest, length))
    assert [f.refused for f in found] == ([] if refused is None else [refused])
    assert all("hem_right" in f.names and "measured length" in f.hint for f in found)


def test_points_off_the_outline_that_was_seen_are_a_doubt() -> None:
    shirt = GARMENTS["t_shirt"]
    points = placed(shirt, angle=0.0)
    outline = np.array(list(points.values()))
    assert check(shirt, points, outline=outline) == ()
    moved = points | {"hem_left": points["hem_left"] + (-30.0, 30.0)}  # outwards from the corner
    (finding,) = check(shirt, moved, outline=outline)
    assert not finding.refused and finding.names == ("hem_left",) and "hem_left by 42 px" in finding.what
