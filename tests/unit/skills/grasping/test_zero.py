"""The pads' zero and the checks that every reading goes through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robots.errors import FailureKind
from skills.grasping.reading import fault
from skills.grasping.settings import GraspSettings
from skills.grasping.zero import start_zero, zero
from skills.vocabulary import Outcome
from tests.hands import CELL_NOISE, SensedHand

SETTINGS = GraspSettings()


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_it_takes_the_drift_away_and_says_how_noisy_the_cells_are(scale: float) -> None:
    for seed in range(50):
        hand = SensedHand(seed, scale)
        state = start_zero(SETTINGS)
        while not isinstance(state, Outcome):
            state = zero(hand.read(), state)
        found = state.unwrap()
        assert found.cell_noise == pytest.approx(scale * CELL_NOISE, rel=0.3)
        np.testing.assert_allclose(found.cells, hand.drift, atol=6 * scale * CELL_NOISE / np.sqrt(12))
        hand.pads = np.array([3.0, 5.0])
        pads = np.mean([found.pads(hand.read()) for _ in range(50)], axis=0)
        np.testing.assert_allclose(pads, hand.pads, rtol=0.02 * scale, atol=0.1 * scale)
        assert found.stamp < hand.now


def test_the_same_reading_twice_counts_once() -> None:
    state, reading = start_zero(SETTINGS), SensedHand(0).read()
    for _ in range(SETTINGS.zero_readings + 1):
        state = zero(reading, state)
    assert not isinstance(state, Outcome) and len(state.cells) == 1


def test_faults_are_named() -> None:
    reading = SensedHand(0).read()
    assert fault(reading, SETTINGS) is None
    late = replace(reading, stamp=reading.stamp + 0.15)
    failure = fault(late, SETTINGS)
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    assert failure.values["age_s"] == pytest.approx(0.15)
    slow = replace(reading, gripper=replace(reading.gripper, stamp=reading.stamp - 0.6))
    assert fault(slow, SETTINGS) is not None
    for bad in (np.nan, np.inf):
        assert fault(replace(reading, height=bad), SETTINGS) is not None
        broken = replace(reading, gripper=replace(reading.gripper, opening=bad))
        failure = fault(broken, SETTINGS)
        assert failure is not None and failure.kind is FailureKind.HARDWARE_FAULT
    timeless = replace(reading, tactile=replace(reading.tactile, stamp=np.nan))
    assert fault(timeless, SETTINGS) is not None
