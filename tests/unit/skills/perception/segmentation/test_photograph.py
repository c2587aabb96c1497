"""Proposals of garments in pictures of places that the project does not draw: planks, tiles, uneven light."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.segmentation.photograph import propose_garments, table_distance

SIZE = (360, 480)
TROUSERS = np.array([[60, 250], [120, 330], [230, 260], [430, 330], [445, 280], [250, 225], [400, 60], [360, 25]])


def planks(seed: int) -> np.ndarray:
    """Planks of different brightness with dark joints, a lamp above the middle and dark corners."""
    rng = np.random.default_rng(seed)
    floor = np.zeros((*SIZE, 3))
    for top in range(0, SIZE[0], 40):
        left = -int(rng.integers(0, 150))
        while left < SIZE[1]:
            colour = np.array([190, 172, 150]) * rng.uniform(0.85, 1.1)
            cv2.rectangle(floor, (left, top), (left + 149, top + 39), colour.tolist(), -1)
            cv2.rectangle(floor, (left, top), (left + 149, top + 39), (120, 105, 90), 1)
            left += 150
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    distance = np.hypot(rows - 170, columns - 230) / 300
    return floor * (1.15 - 0.5 * distance**2)[..., None]


def picture(
    ground: np.ndarray, colour: tuple[int, int, int], *polygons: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    mask = np.zeros(SIZE, np.uint8)
    for polygon in polygons:
        cv2.fillPoly(mask, [polygon.astype(np.int32)], 1)
    soft = cv2.GaussianBlur(mask.astype(float), (0, 0), 0.7)[..., None]
    noise = np.random.default_rng(0).normal(0, 2.0, (*SIZE, 3))
    rgb = ground * (1 - soft) + np.array(colour) * soft + noise
    return np.clip(rgb, 0, 255).astype(np.uint8), mask > 0


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("colour", [(25, 28, 35), (60, 80, 130), (120, 50, 45)])
def test_trousers_on_planks_are_among_the_proposals(seed: int, colour: tuple[int, int, int]) -> None:
    rgb, truth = picture(planks(seed), colour, TROUSERS)
    found = propose_garments(rgb, np.ones(SIZE, bool))
    assert max(overlap(p.mask, truth) for p in found) > 0.97
    assert overlap(found[0].mask, truth) > 0.95, "the most likely proposal"


def test_bare_planks_have_no_outline_that_is_as_clear_as_a_garment() -> None:
    bare = propose_garments(np.clip(planks(3), 0, 255).astype(np.uint8), np.ones(SIZE, bool))
    rgb, _ = picture(planks(3), (60, 80, 130), TROUSERS)
    garment = propose_garments(rgb, np.ones(SIZE, bool))[0]
    assert all(p.confidence < garment.confidence for p in bare)


def test_a_second_garment_is_one_of_the_other_things() -> None:
    left = np.array([[40, 60], [200, 60], [200, 260], [40, 260]])
    rgb, truth = picture(planks(4), (40, 60, 140), left, left + np.array([230, 20]))
    best = propose_garments(rgb, np.ones(SIZE, bool))[0]
    rest = truth & ~best.mask
    assert overlap(best.others, rest) > 0.8


def test_what_touches_the_border_is_not_proposed_with_a_clear_outline() -> None:
    rgb, truth = picture(planks(5), (40, 60, 140), np.array([[-10, 60], [200, 60], [200, 260], [-10, 260]]))
    found = propose_garments(rgb, np.ones(SIZE, bool))
    assert all(p.confidence < 0.7 for p in found if (p.mask & truth).any())


def test_the_distance_from_the_floor_is_even_under_a_lamp() -> None:
    """A floor of one colour under a lamp is as far from its model as the noise of the picture says."""
    rows, columns = np.mgrid[:240, :320] / 240.0
    light = 150 - 60 * (rows - 0.4) ** 2 + 30 * (columns - 0.7)
    noise = np.random.default_rng(1).normal(0, 1.0, (240, 320, 3))
    lab = np.stack([light, np.full_like(light, 130), np.full_like(light, 140)], axis=2) + noise
    distance = table_distance(lab.astype(np.float32), np.ones((240, 320), bool))
    assert np.quantile(distance, 0.999) < 4.0, "the rim is as dark and as bright as the middle"


def test_a_print_on_a_garment_is_no_proposal() -> None:
    cloth = np.array([[90, 40], [390, 40], [390, 320], [90, 320]])
    rgb, truth = picture(planks(6), (40, 60, 140), cloth)
    patch = np.array([[180, 110], [320, 120], [310, 230], [170, 220]])
    cv2.fillPoly(rgb, [patch.astype(np.int32)], (240, 90, 60))
    printed = cv2.fillPoly(np.zeros(SIZE, np.uint8), [patch.astype(np.int32)], 1) > 0
    found = propose_garments(rgb, np.ones(SIZE, bool))
    assert max(overlap(p.mask, truth) for p in found) > 0.9
    assert all(overlap(p.mask, printed) < 0.5 for p in found)
