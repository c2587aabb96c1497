"""The ideal fold as a yardstick: it passes, every kind of failure fails, and it never delays or outlives a run."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.score_matrix import KINDS, IdealGarment, drawn_garment, ideal_garment, judged, spoiled
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.simulation.garment.cloth_body import solver_settings
from foldcell.cell.simulation.scoring.ground_truth_recorder import GroundTruthRecorder
from foldcell.cell.simulation.scoring.ideal import BackgroundIdeal, flaw_of, ideal_heights, ideal_of
from foldcell.cell.simulation.truth import GarmentTruth
from foldcell.cell.view.recorder import Recorder
from foldcell.skills.fold_plan.crease_mesh import mesh_near_creases
from foldcell.skills.fold_plan.ideal_fold import SETTLE_S, IdealFold, ideal_folds
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.garments.garment import Garment

TOWEL = "small_towel", 9001


@pytest.fixture(scope="module", params=["small_towel", "vest", "long_sleeve_shirt_small"])
def ideal(request: pytest.FixtureRequest) -> IdealGarment:
    return ideal_garment(request.param, 9001)


@pytest.fixture(scope="module")
def towel() -> GarmentTruth:
    """On a coarse mesh: what the thread, the recorder and the time to settle promise holds on every mesh."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("foldcell.cell.simulation.garment.garment.mesh_near_creases", coarse)
        return drawn_garment(*TOWEL)


def coarse(contour: Any, edge: float, layers: int, turn: float, creases: Any, length: float, fine: float) -> Any:
    return mesh_near_creases(contour, edge, layers, turn, creases, length, edge)


@pytest.fixture(scope="module")
def settled(towel: GarmentTruth) -> tuple[IdealFold, ...]:
    """The ideal folds of the towel by its preferred way."""
    return ideal_folds(towel.mesh, ways(towel)[0], towel.fabric, solver_settings(towel.traits))


@pytest.fixture(scope="module")
def background(towel: GarmentTruth) -> BackgroundIdeal:
    return BackgroundIdeal(towel, lambda: plan(towel))


def plan(garment: GarmentTruth) -> Garment:
    return load_garment(garment.name)


def ways(garment: GarmentTruth) -> tuple[Any, ...]:
    return ways_to_fold(plan(garment), garment.keypoints)


# --- the yardstick -------------------------------------------------------------------------------------


def test_the_ideal_passes(ideal: IdealGarment) -> None:
    result = judged(ideal, ideal.vertices)
    assert ideal.heights.flaw is None and result.passed, result.to_json()


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_failure_fails_a_figure(ideal: IdealGarment, kind: str) -> None:
    result = judged(ideal, spoiled(ideal, kind))
    assert not result.passed and result.failed


def test_a_stack_may_be_3_mm_higher_than_the_ideal_or_10_mm_higher_than_its_flat_layers(
    ideal: IdealGarment,
) -> None:
    """The larger of the two counts. Beside creases, 10 mm above the ideal are allowed."""
    result = judged(ideal, ideal.vertices)
    by_layers, by_ideal = result.stack + 0.010, ideal.heights.height + 0.003
    assert result.figures["height_m"].limit == pytest.approx(max(by_layers, by_ideal))
    allowed = min(max(by_layers, by_ideal) - ideal.heights.height, 0.010)
    for more, flat in ((-0.0005, True), (0.0005, False)):
        raised = judged(ideal, ideal.vertices + np.array([0.0, 0.0, allowed + more]))
        assert raised.shape and raised.flat is flat, raised.to_json()


@pytest.mark.parametrize(
    ("fold", "iou", "word"),
    [
        (IdealFold(np.zeros((1, 3)), 0.0, 3, 0.0), 1.0, "through each other"),
        (IdealFold(np.zeros((1, 3)), 0.0, 0, 0.06), 1.0, "strained"),
        (IdealFold(np.zeros((1, 3)), 0.001, 0, 0.0), 1.0, "rest"),
        (IdealFold(np.zeros((1, 3)), 0.0, 0, 0.0), 0.8, "overlaps"),
    ],
)
def test_an_ideal_with_a_flaw_is_no_yardstick(ideal: IdealGarment, fold: IdealFold, iou: float, word: str) -> None:
    flaw = flaw_of(fold, iou)
    assert flaw is not None and word in flaw
    flawed = replace(ideal, heights=replace(ideal.heights, flaw=flaw))
    result = judged(flawed, flawed.vertices)
    assert result.shape and result.flat is None and not result.passed
    figures = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert figures["ideal"]["valid"] is False and figures["ideal"]["reason"] == flaw
    assert "height_m" not in figures["limits"] and figures["height_m"] > 0.0


def test_the_score_states_the_ideal_and_its_validity(ideal: IdealGarment) -> None:
    figures = json.loads(json.dumps(judged(ideal, ideal.vertices).to_json(), allow_nan=False))
    assert figures["passed"] and figures["shape"] and figures["flat"]
    assert figures["ideal_height_m"] == pytest.approx(figures["height_m"], abs=0.001)
    assert figures["ideal_crease_height_m"] == pytest.approx(figures["crease_height_m"], abs=0.001)
    valid = figures["ideal"]
    assert valid["valid"] and valid["reason"] is None and valid["crossings"] == 0
    assert valid["strain"] <= 0.05 and valid["motion_m"] < 5e-4 and valid["iou"] > 0.9


def test_stiff_nested_creases_that_push_the_layers_aside_are_folded_again_more_slowly() -> None:
    """In this fabric, a quick turn ends with edges 30 mm apart."""
    stiff = ideal_garment("small_towel", 9002)
    assert judged(stiff, stiff.vertices).passed


# --- time to settle ------------------------------------------------------------------------------------


def test_a_garment_that_sleeps_does_not_change_any_more(
    towel: GarmentTruth, settled: tuple[IdealFold, ...]
) -> None:
    settings, lines = solver_settings(towel.traits), ways(towel)[0]
    for a, b in zip(settled, ideal_folds(towel.mesh, lines, towel.fabric, settings, 2 * SETTLE_S), strict=True):
        assert a.rest_s < SETTLE_S and a.motion < 5e-4 and a.crossings == 0 and a.strain <= 0.05
        assert np.array_equal(a.vertices, b.vertices)


def test_a_prefix_of_the_lines_gives_the_same_folds(towel: GarmentTruth, settled: tuple[IdealFold, ...]) -> None:
    (half,) = ideal_folds(towel.mesh, ways(towel)[0][:1], towel.fabric, solver_settings(towel.traits))
    assert np.array_equal(half.vertices, settled[0].vertices)


# --- the thread ----------------------------------------------------------------------------------------


def test_the_thread_finds_what_a_call_finds_and_follows_the_way_that_was_taken(
    towel: GarmentTruth, background: BackgroundIdeal
) -> None:
    first, second = ways(towel)[:2]
    assert (
        background.heights(first, [18.0, 12.0])
        == background.heights(first)
        == ideal_heights(towel, plan(towel), first)
    )
    assert background.heights(second) == ideal_heights(towel, plan(towel), second)


def test_a_fold_that_had_less_time_to_settle_is_compared_with_such_an_ideal(
    towel: GarmentTruth, background: BackgroundIdeal
) -> None:
    lines, dwell_s = ways(towel)[0], [12.0, 0.1]
    assert background.heights(lines, dwell_s) == ideal_heights(towel, plan(towel), lines, dwell_s)


def test_a_garment_that_cannot_be_simulated_has_no_valid_ideal(towel: GarmentTruth) -> None:
    odd = replace(towel, fabric=replace(towel.fabric, areal_mass=100.0))
    lines = ways(towel)[0]
    heights = BackgroundIdeal(odd, lambda: plan(odd)).heights(lines)
    assert heights.flaw is not None and "areal_mass" in heights.flaw
    written = json.loads(json.dumps(heights.to_json(), allow_nan=False))
    assert written["valid"] is False and written["iou"] is None


def test_a_cancelled_computation_ends() -> None:
    garment = drawn_garment("jeans", 9002)
    background = BackgroundIdeal(garment, lambda: plan(garment))
    background.cancel()
    with pytest.raises(ZeroDivisionError):
        ideal_of(garment, plan(garment), ways(garment)[0], go_on=lambda: 1 // 0)


# --- the recorder --------------------------------------------------------------------------------------


def recorder(garment: GarmentTruth) -> tuple[GroundTruthRecorder, Any]:
    """A recorder that has seen the garment lie on the table, and the source of the truth."""
    seen = SimpleNamespace(stamp=1.0, garment=garment, tools={}, held={})
    source: Any = SimpleNamespace(tell=None, now=lambda: seen)
    source.watch = lambda tell: setattr(source, "tell", tell)
    request: Any = SimpleNamespace(garment=garment.name, settings=SimpleNamespace(surface="bare_table"))
    found = GroundTruthRecorder(source, Recorder.silent(), request)
    source.tell(seen)
    return found, source


def at_work() -> bool:
    return any(thread.name == "ideal fold" for thread in threading.enumerate())


def test_the_thread_ends_with_the_recorder_also_without_a_score() -> None:
    found, _ = recorder(drawn_garment("jeans", 9002))
    assert at_work()
    found.close()
    assert not at_work()


def test_a_run_that_was_stopped_does_not_wait_for_the_ideal(towel: GarmentTruth) -> None:
    found, source = recorder(towel)
    result = found.score(whole=False)
    assert result is not None and not result.shape and not result.passed
    assert result.flat is None and result.ideal is None
    assert source.tell is None and not at_work()


def test_a_garment_of_the_mujoco_world_has_no_ideal(towel: GarmentTruth) -> None:
    found, _ = recorder(replace(towel, solver="mujoco"))
    assert not at_work()
    result = found.score()
    assert result is not None and result.flat is None and result.passed is result.shape
