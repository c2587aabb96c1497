"""The mean depth of several exposures."""

from __future__ import annotations

import numpy as np

from foldcell.robots.depth_averaging import MAX_SPREAD, mean_depth

SHAPE = (40, 50)


def noisy(count: int, deviation: float = 0.002) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [(1.1 + deviation * rng.standard_normal(SHAPE)).astype(np.float32) for _ in range(count)]


def test_noise_decreases_with_the_root_of_the_number_of_exposures() -> None:
    for count in (2, 8, 32):
        error = mean_depth(noisy(count)) - 1.1
        assert abs(error.std() - 0.002 / np.sqrt(count)) < 0.1 * 0.002 / np.sqrt(count)


def test_cells_seen_by_a_minority_of_exposures_are_invalid() -> None:
    exposures = noisy(8)
    for k, exposure in enumerate(exposures):
        exposure[0, :] = np.nan if k < 4 else exposure[0, :]
        exposure[1, :] = np.nan if k < 5 else exposure[1, :]
        exposure[2, :] = np.nan
    mean = mean_depth(exposures)
    assert np.isfinite(mean[0]).all() and np.isnan(mean[1:3]).all() and np.isfinite(mean[3:]).all()


def test_depth_beside_an_edge_is_never_between_the_two_surfaces() -> None:
    for seen, near in ((8, 3), (8, 4), (7, 3), (6, 3), (5, 2)):
        exposures = noisy(8)
        for k, exposure in enumerate(exposures):
            exposure[5, :] = np.nan if k >= seen else exposure[5, :] - (4.0 * MAX_SPREAD if k < near else 0.0)
        off = np.abs(mean_depth(exposures)[5] - np.array([[1.1], [1.1 - 4.0 * MAX_SPREAD]])).min(axis=0)
        assert off.max() < 0.01, (seen, near)
    assert np.abs(mean_depth([np.full((1, 1), 1.0, np.float32), np.full((1, 1), 1.1, np.float32)]) - 1.0) < 1e-6


def test_averaging_one_exposure_returns_it_and_inputs_stay_unchanged() -> None:
    one = noisy(1)[0]
    assert mean_depth([one]) is one
    exposures = noisy(8)
    before = [e.copy() for e in exposures]
    mean = mean_depth(exposures)
    assert mean.dtype == np.float32 and not mean.flags.writeable
    assert all(np.array_equal(a, b) for a, b in zip(exposures, before, strict=True))
