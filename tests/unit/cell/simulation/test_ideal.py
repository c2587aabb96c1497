"""The ideal fold as a yardstick: it passes, and every kind of failure fails, for shipped garments."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.score_matrix import KINDS, IdealGarment, ideal_garment, judged, spoiled
from cell.config.garments.garment_file import load_garment
from cell.simulation.garment.garment import WorldGarment
from cell.simulation.noise import load_noise
from cell.simulation.scoring.ideal import BackgroundIdeal, flaw_of, ideal_heights
from cell.simulation.truth import GarmentTruth
from skills.planning.ideal_fold import IdealFold
from skills.planning.plan import ways_to_fold


@pytest.fixture(scope="module", params=["small_towel", "medium_towel", "jeans"])
def ideal(request: pytest.FixtureRequest) -> IdealGarment:
    return ideal_garment(request.param, 9001)


def test_the_ideal_passes(ideal: IdealGarment) -> None:
    result = judged(ideal, ideal.vertices)
    assert ideal.heights.flaw is None and result.passed, result.to_json()


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_failure_fails_a_figure(ideal: IdealGarment, kind: str) -> None:
    result = judged(ideal, spoiled(ideal, kind))
    assert not result.passed and result.failed


def test_a_lower_ideal_asks_for_more(ideal: IdealGarment) -> None:
    """A stack 8 mm above the ideal fails, if the flat layers alone would not allow it."""
    raised = ideal.vertices + np.array([0.0, 0.0, 0.030])
    assert judged(ideal, raised).flat is False and judged(ideal, raised).shape


@pytest.mark.parametrize(
    ("fold", "iou", "word"),
    [
        (IdealFold(np.zeros((1, 3)), 0.0, 3, 0.0), 1.0, "through each other"),
        (IdealFold(np.zeros((1, 3)), 0.0, 0, 0.06), 1.0, "stretched"),
        (IdealFold(np.zeros((1, 3)), 0.001, 0, 0.0), 1.0, "rest"),
        (IdealFold(np.zeros((1, 3)), 0.0, 0, 0.0), 0.8, "overlaps"),
    ],
)
def test_an_ideal_with_a_flaw_is_no_yardstick(fold: IdealFold, iou: float, word: str) -> None:
    flaw = flaw_of(fold, iou)
    assert flaw is not None and word in flaw


def truth(name: str, seed: int) -> GarmentTruth:
    world = WorldGarment(load_garment(name), load_noise().garment, np.random.default_rng(seed), False)
    pose = (world.pose.x, world.pose.y, world.pose.angle)
    return GarmentTruth(
        name, world.flat, world.mesh.triangles, world.flat, world.keypoints, pose, world.material, world.layers,
        world.mesh, world.traits, "xpbd",
    )  # fmt: skip


def test_the_thread_finds_what_a_call_finds_and_follows_the_way_that_was_taken() -> None:
    garment = truth("small_towel", 9002)
    ways = ways_to_fold(load_garment("small_towel"), garment.keypoints)
    background = BackgroundIdeal(garment, lambda: ways[0])
    assert background.heights(ways[0]) == ideal_heights(garment, ways[0])
    assert background.heights(ways[1]) == ideal_heights(garment, ways[1])


def test_a_cancelled_thread_ends() -> None:
    garment = truth("jeans", 9002)
    background = BackgroundIdeal(garment, lambda: ways_to_fold(load_garment("jeans"), garment.keypoints)[0])
    background.cancel()
    with pytest.raises(ZeroDivisionError):
        ideal_heights(garment, ways_to_fold(load_garment("jeans"), garment.keypoints)[0], lambda: 1 // 0)
