"""The tactile cells: one sample each 10 ms, with noise and linearity from the noise table."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.robot.tactile import SimulatedTactile
from foldcell.robots.ports import Side

NOISE = load_noise().tactile


def sensor(force: float, ideal: bool = False, seed: int = 3) -> SimulatedTactile:
    return SimulatedTactile(Side.LEFT, NOISE, seed, ideal, lambda: force, lambda: np.array([0.2, 0.4]))


def test_all_queries_within_one_sample_get_the_same_reading() -> None:
    asked_once, asked_often = sensor(5.0), sensor(5.0)
    for t in np.arange(0, 0.05, 0.003):
        asked_often.reading(float(t))
    a, b = asked_once.reading(0.0512), asked_often.reading(0.0512)
    np.testing.assert_array_equal(a.cells, b.cells)
    assert a.stamp == pytest.approx(0.05)
    assert asked_often.reading(0.0555) is asked_often.reading(0.0512)


def test_the_cells_of_a_pad_add_up_to_the_grip() -> None:
    exact = sensor(8.0, ideal=True).reading(0.0)
    assert exact.cells.sum(axis=(1, 2)) == pytest.approx([8.0, 8.0])
    assert exact.grip == pytest.approx(8.0)
    assert exact.tip.tolist() == [0.2, 0.4]
    assert sensor(8.0).reading(0.0).grip == pytest.approx(8.0, rel=0.06)


def test_cloth_that_hangs_on_a_finger_is_felt_by_its_pad_alone() -> None:
    tips, nothing = lambda: np.zeros(2), lambda: 0.0
    hung = SimulatedTactile(Side.LEFT, NOISE, 3, True, nothing, tips, clinging=lambda: 0.4).reading(0.0)
    assert hung.cells.sum(axis=(1, 2)) == pytest.approx([0.4, 0.0])
    assert hung.grip == 0.0, "the open hand grips nothing"


def test_the_noise_has_the_size_stated_in_the_table() -> None:
    s = sensor(0.0)
    readings = np.array([s.reading(0.01 * k).cells for k in range(200)])
    assert np.diff(readings, axis=0).std() / np.sqrt(2) == pytest.approx(NOISE.noise, rel=0.1)


def test_drift_is_slow_and_differs_from_cell_to_cell() -> None:
    s = sensor(0.0)
    means = [np.mean([s.reading(t0 + 0.01 * k).cells for k in range(100)], axis=0) for t0 in (0.0, 40.0)]
    assert np.ptp(means[0]) > 0.5 * NOISE.drift
    assert np.abs(means[1] - means[0]).max() > 0.5 * NOISE.drift
