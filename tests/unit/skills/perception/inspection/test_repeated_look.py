"""Heights of two looks at a garment at rest are averaged."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.skills.perception.inspection.inspect import averaged_height
from tests.inspections import inspection

MASK = np.zeros((80, 100), bool)
MASK[20:60, 20:80] = True


def noisy(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.01, 0.002, MASK.shape).astype(np.float32)


def test_noise_falls_with_the_root_of_the_number_of_looks() -> None:
    seen = averaged_height(noisy(1), MASK, inspection(height=noisy(2), mask=MASK))
    assert seen.std() == pytest.approx(0.002 / 2**0.5, rel=0.05) and seen.mean() == pytest.approx(0.01, abs=1e-4)


def test_what_one_look_did_not_see_is_that_of_the_other() -> None:
    first, now = noisy(2), noisy(1)
    first[25] = np.nan
    now[30] = np.nan
    seen = averaged_height(now, MASK, inspection(height=first, mask=MASK))
    assert np.array_equal(seen[25], now[25]) and np.isnan(seen[30]).all()


def test_a_garment_that_has_moved_is_seen_anew() -> None:
    now = noisy(1)
    assert averaged_height(now, MASK, inspection(height=noisy(2), mask=np.roll(MASK, 3, axis=1))) is now
    assert averaged_height(now, MASK, inspection(height=noisy(2)[:, :50], mask=MASK[:, :50])) is now


def test_a_pile_that_was_smoothed_within_the_outline_is_seen_anew() -> None:
    piled, now = noisy(2), noisy(1)
    piled[30:40, 30:45] += 0.02
    assert averaged_height(now, MASK, inspection(height=piled, mask=MASK)) is now
