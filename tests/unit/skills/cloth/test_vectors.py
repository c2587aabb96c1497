"""Vectors in registers against numpy."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from skills.cloth.vectors import WIDTH, cross, dot, load, rows, store, vector


@njit
def computed(given, out):
    a, b = load(given, 0), load(given, 1)
    store(out, 0, a + b)
    store(out, 1, a - b)
    store(out, 2, -a)
    store(out, 3, 2.5 * a)
    store(out, 4, cross(a, b))
    store(out, 5, vector(dot(a, b), 1.0, 2.0))


@pytest.mark.parametrize("seed", range(5))
def test_they_compute_as_numpy_does_and_the_fourth_column_stays_zero(seed):
    given, out = rows(2), rows(7)
    given[:, :3] = np.random.default_rng(seed).normal(size=(2, 3))
    computed(given, out)
    a, b = given[:, :3]
    expected = [a + b, a - b, -a, 2.5 * a, np.cross(a, b), [a @ b, 1.0, 2.0], np.zeros(3)]
    np.testing.assert_allclose(out[:, :3], expected, rtol=0, atol=1e-14)
    assert not out[:, 3].any()


@njit
def first(given, out):
    store(out, 0, load(given, 0))


@pytest.mark.parametrize("wrong", [np.zeros((2, 4), np.float32), np.zeros(4), np.zeros((4, 2)).T])
def test_other_arrays_are_refused(wrong):
    with pytest.raises(TypingError, match="C-ordered"):
        first(wrong, rows(1))


@pytest.mark.parametrize("n", [1, 7, 1000])
def test_rows_are_zero_writable_and_never_cross_a_line_of_the_cache(n):
    made = rows(n)
    assert made.shape == (n, WIDTH) and made.flags.c_contiguous and not made.any()
    assert made.ctypes.data % 64 == 0
    made += 1.0
