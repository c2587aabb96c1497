"""Tare of the pads, and the validation of readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.grasping.hand_reading import validate_reading
from foldcell.skills.grasping.tare import TARE_READINGS, TactileBias, TareState, tare
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP
from tests.hands import CELL_NOISE, TIP_NOISE, SensedHand

SETTINGS = GRASP


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_tare_removes_the_drift_and_returns_the_noise(scale: float) -> None:
    for seed in range(50):
        hand = SensedHand(seed, scale)
        state = TareState(SETTINGS)
        while not isinstance(state, Outcome):
            state = tare(hand.read(), state)
        found = state.unwrap()
        assert found.cell_noise == pytest.approx(scale * CELL_NOISE, rel=0.3)
        np.testing.assert_allclose(found.cells, hand.drift, atol=6 * scale * CELL_NOISE / np.sqrt(12))
        hand.pads = np.array([3.0, 5.0])
        pads = np.mean([found.pads(hand.read()) for _ in range(50)], axis=0)
        np.testing.assert_allclose(pads, hand.pads, rtol=0.02 * scale, atol=0.1 * scale)
        assert found.stamp < hand.now


def bias_with(hand: SensedHand, leaps: dict[int, tuple[tuple[int, ...], float]], tip: float = 0.0) -> TactileBias:
    """The bias from readings with outliers. leaps: index of a reading -> (cell, error [N]). tip: error of tip 0 in
    the same readings [N]."""
    state = TareState(SETTINGS)
    for k in range(10 * TARE_READINGS):
        reading = hand.read()
        if k in leaps:
            cells, tips = reading.tactile.cells.copy(), reading.tactile.tip.copy()
            cells[leaps[k][0]] += leaps[k][1]
            tips[0] += tip
            reading = replace(reading, tactile=replace(reading.tactile, cells=cells, tip=tips))
        state = tare(reading, state)
        if isinstance(state, Outcome):
            return state.unwrap()
    raise AssertionError("the tare did not end")


@pytest.mark.parametrize("by", [-3.0, 1.0, 8.0])
@pytest.mark.parametrize("when", [(0,), (5,), (11,), (3, 4, 5), (1, 13, 15)])
def test_outlier_readings_do_not_change_bias_and_noise(when: tuple[int, ...], by: float) -> None:
    for seed in range(10):
        hand = SensedHand(seed)
        found = bias_with(hand, dict.fromkeys(when, ((1, 2, 0), by)), tip=by)
        assert found.cell_noise == pytest.approx(CELL_NOISE, rel=0.3)
        np.testing.assert_allclose(found.cells, hand.drift, atol=6 * CELL_NOISE / np.sqrt(12))
        assert np.abs(found.tip).max() < 6 * TIP_NOISE / np.sqrt(12)


def test_tare_accepts_cells_that_never_settle() -> None:
    """One cell is very noisy. The tare ends, and its noise estimate is large."""
    leaps = {k: ((1, 2, 0), 3.0 * (-1) ** k) for k in range(10 * TARE_READINGS)}
    assert bias_with(SensedHand(0), leaps).cell_noise > 0.3


def test_without_outliers_the_bias_is_the_mean_of_the_first_readings() -> None:
    hand, again = SensedHand(1, 2.0), SensedHand(1, 2.0)
    readings = [again.read() for _ in range(TARE_READINGS)]
    np.testing.assert_array_equal(bias_with(hand, {}).cells, np.mean([r.tactile.cells for r in readings], axis=0))


def test_a_repeated_reading_counts_once_in_the_tare() -> None:
    state, reading = TareState(SETTINGS), SensedHand(0).read()
    for _ in range(TARE_READINGS + 1):
        state = tare(reading, state)
    assert not isinstance(state, Outcome) and len(state.cells) == 1


def test_unusable_readings_are_refused_with_their_reason() -> None:
    reading = SensedHand(0).read()
    assert validate_reading(reading) is None
    late = replace(reading, stamp=reading.stamp + 0.15)
    failure = validate_reading(late)
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    assert failure.values["age_s"] == pytest.approx(0.15)
    slow = replace(reading, gripper=replace(reading.gripper, stamp=reading.stamp - 0.6))
    assert validate_reading(slow) is not None
    for bad in (np.nan, np.inf):
        assert validate_reading(replace(reading, height=bad)) is not None
        broken = replace(reading, gripper=replace(reading.gripper, opening=bad))
        failure = validate_reading(broken)
        assert failure is not None and failure.kind is FailureKind.GRIPPER_FAULT
    timeless = replace(reading, tactile=replace(reading.tactile, stamp=np.nan))
    assert validate_reading(timeless) is not None
