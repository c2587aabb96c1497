"""Vectors in SIMD lanes against numpy."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from foldcell.skills.cloth.simd.vec3 import WIDTH, cross, dot, load, members, spread, store, vector
from tests.builders.cloth import rows


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
def test_operations_agree_with_numpy_and_the_fourth_column_stays_zero(seed):
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
def test_arrays_of_another_type_or_layout_are_refused(wrong):
    with pytest.raises(TypingError, match="C-ordered"):
        first(wrong, rows(1))


@njit
def weighed(x, member, weight, out):
    for c in range(len(member)):
        i, j, k, m = members(member, c)
        a, b, d, e = spread(load(weight, c))
        store(out, c, a * load(x, i) + b * load(x, j) + d * load(x, k) + e * load(x, m))


def test_the_weighted_sum_of_four_vertices_agrees_with_numpy():
    rng = np.random.default_rng(1)
    x, out, weight = rows(20), rows(9), rng.normal(size=(9, 4))
    x[:, :3] = rng.normal(size=(20, 3))
    member = rng.integers(0, 20, size=(9, 4)).astype(np.uint32)
    weighed(x, member, weight, out)
    np.testing.assert_allclose(out, np.einsum("ck,ckd->cd", weight, x[member]), rtol=0, atol=1e-14)


@pytest.mark.parametrize("wrong", [np.zeros((2, 4), np.int32), np.zeros(4, np.uint32), np.zeros((2, 4))])
def test_the_weighted_sum_refuses_indices_of_another_type(wrong):
    with pytest.raises(TypingError, match="uint32"):
        weighed(rows(1), wrong, rows(1), rows(1))


@pytest.mark.parametrize("n", [1, 7, 1000])
def test_new_rows_are_zero_writable_and_cache_aligned(n):
    made = rows(n)
    assert made.shape == (n, WIDTH) and made.flags.c_contiguous and not made.any()
    assert made.ctypes.data % 64 == 0
    made += 1.0
