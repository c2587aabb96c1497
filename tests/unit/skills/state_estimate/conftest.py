"""One fold of a small towel of the simulated world, shared by the tests of this folder."""

import numpy as np
import pytest

from benchmarks.interrupted_folds import open_fold


@pytest.fixture(scope="package")
def fold():
    with open_fold("small_towel", 21) as opened:
        yield opened


@pytest.fixture
def rng():
    return np.random.default_rng(5)
