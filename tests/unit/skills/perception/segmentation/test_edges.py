"""A garment of the ground's colour is found by its edges, whatever its folds and prints look like."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest
import shapely

from foldcell.skills.perception.segmentation.edges import cheapest_path, segment_by_edges

SIZE = (420, 560)
SHIRT = np.array([[200, 90], [250, 105], [310, 105], [360, 90], [450, 150], [415, 205], [370, 180], [375, 350],
                  [185, 350], [190, 180], [145, 205], [110, 150]])  # fmt: skip
WHITE = np.array([215.0, 214.0, 210.0])
EVERYWHERE = np.ones(SIZE, bool)


def covered(polygon: np.ndarray) -> np.ndarray:
    cover = cv2.fillPoly(np.zeros(SIZE, np.float32), [polygon.astype(np.int32)], 1.0)
    return cv2.GaussianBlur(cover, (0, 0), 0.7)[..., None]


def photograph(
    polygon: np.ndarray, colour: np.ndarray, *, stripes: bool = False, wood: bool = False, lit: float = 45.0
) -> np.ndarray:
    """A picture of a garment with soft folds, which shade it by more than it differs from the ground. Its upper
    and left edges are lit, and its right and lower ones throw a soft shadow. wood: the ground has a grain."""
    rng = np.random.default_rng(0)
    folds = 8.0 * cv2.GaussianBlur(rng.normal(0, 1, SIZE), (0, 0), 18.0) * 18.0 * np.sqrt(4 * np.pi)
    cover = covered(polygon)
    grain = cv2.GaussianBlur(rng.normal(0, 60, (SIZE[0], 1)), (1, 0), 1.0) if wood else np.zeros((SIZE[0], 1))
    moved = cv2.GaussianBlur(np.roll(cover, (2, 2), axis=(0, 1)), (0, 0), 2.0)[..., None]
    ground = WHITE + grain[..., None] - 90.0 * moved
    bands = 60.0 * (np.arange(SIZE[0]) % 20 < 5) if stripes else np.zeros(SIZE[0])
    cloth = colour + folds[..., None] - bands[:, None, None] + lit * (1.0 - moved)
    rgb = ground * (1 - cover) + cloth * cover + rng.normal(0, 1.5, (*SIZE, 3))
    return np.clip(rgb, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("stripes", [False, True], ids=["plain", "striped"])
@pytest.mark.parametrize("lighter", [8.0, 0.0, -8.0])
def test_white_on_white_is_found_by_its_edge_to_a_hundredth_of_its_size(lighter: float, stripes: bool) -> None:
    found = segment_by_edges(photograph(SHIRT, WHITE + lighter, stripes=stripes), EVERYWHERE)
    assert found is not None and found.confidence > 0.9
    away = shapely.distance(shapely.LinearRing(SHIRT), shapely.points(found.contour))
    assert np.median(away) < 3.5 and np.quantile(away, 0.9) < 4.5
    missed = shapely.distance(shapely.LinearRing(found.contour), shapely.points(SHIRT))
    assert missed.max() < 12.0, "no corner is cut off"
    truth = covered(SHIRT)[..., 0] > 0.5
    assert np.count_nonzero(found.mask ^ truth) < 0.06 * np.count_nonzero(truth)


@pytest.mark.parametrize("stripes", [False, True], ids=["plain", "striped"])
@pytest.mark.parametrize("lighter", [8.0, 4.0, 0.0, -4.0, -8.0])
def test_where_an_edge_fades_the_confidence_says_how_much_was_found(lighter: float, stripes: bool) -> None:
    found = segment_by_edges(photograph(SHIRT, WHITE + lighter, stripes=stripes, lit=0.0), EVERYWHERE)
    truth = covered(SHIRT)[..., 0] > 0.5
    overlap = 1.0 if found is None else np.count_nonzero(found.mask & truth) / np.count_nonzero(found.mask | truth)
    assert found is None or found.confidence < overlap + 0.08


@pytest.mark.parametrize("other", [WHITE + 8.0, np.array([60.0, 80.0, 140.0])], ids=["white", "another colour"])
def test_another_thing_on_the_ground_is_told(other: np.ndarray) -> None:
    half, beside = (SHIRT * 0.6).astype(int), np.array([[400, 120], [520, 125], [515, 240], [398, 236]])
    rgb, second = photograph(half, WHITE + 8.0), photograph(beside, other)
    rgb[:, 370:] = second[:, 370:]
    found = segment_by_edges(rgb, EVERYWHERE)
    assert found is not None and found.others_share > 0.5
    alone = segment_by_edges(photograph(half, WHITE + 8.0), EVERYWHERE)
    assert alone is not None and alone.others_share < 0.05


@pytest.mark.parametrize("moved", [(0, 80), (0, 150), (150, 0), (-180, 0)])
def test_a_garment_that_the_border_cuts_off_is_not_clear(moved: tuple[int, int]) -> None:
    found = segment_by_edges(photograph(SHIRT + np.array(moved), WHITE - 8.0), EVERYWHERE)
    assert found is None or found.confidence < 0.8


@pytest.mark.parametrize(
    ("polygon", "colour", "wood"),
    [
        (SHIRT, np.array([60.0, 80.0, 140.0]), False),
        (SHIRT, WHITE - 8.0, True),
        (SHIRT // 12, WHITE - 8.0, False),
    ],
    ids=["another colour", "a grain", "too small"],
)
def test_nothing_is_said_of_another_colour_uneven_ground_or_small_things(
    polygon: np.ndarray, colour: np.ndarray, wood: bool
) -> None:
    assert segment_by_edges(photograph(polygon, colour, wood=wood), EVERYWHERE) is None


@pytest.mark.parametrize("seed", range(5))
def test_the_cheapest_path_is_the_cheapest_of_all_paths(seed: int) -> None:
    cost, price = np.random.default_rng(seed).uniform(0, 1, (6, 4)), 0.2

    def total(path: tuple[int, ...]) -> float:
        moves = np.abs(np.diff(path))
        return np.inf if moves.max() > 1 else float(cost[np.arange(6), list(path)].sum() + price * moves.sum())

    found = tuple(cheapest_path(cost, price).tolist())
    assert total(found) == pytest.approx(min(map(total, itertools.product(range(4), repeat=6))))
