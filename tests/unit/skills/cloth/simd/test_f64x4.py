"""Four double-precision lanes against numpy."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from foldcell.skills.cloth.simd.f64x4 import dots, ends, gather_f64x4, load_f64x4, splat_f64x4, where_above
from foldcell.skills.cloth.simd.vec3 import dot, load, store, vector
from tests.builders.cloth import rows


@njit(error_model="numpy")
def of_four_edges(x, edge, first, number, out):
    i, j = ends(edge, first)
    a = load(x, i[0]), load(x, i[1]), load(x, i[2]), load(x, i[3])
    b = load(x, j[0]), load(x, j[1]), load(x, j[2]), load(x, j[3])
    store(out, 0, dots(a, b))
    store(out, 1, vector(dot(a[0], b[0]), dot(a[1], b[1]), dot(a[2], b[2])))
    own, other = load_f64x4(number, first), gather_f64x4(number, j)
    store(out, 2, own)
    store(out, 3, other)
    store(out, 4, own / other)
    store(out, 5, where_above(own, other, own, splat_f64x4(7.0)))


@pytest.mark.parametrize("first", [0, 3, 5])
def test_four_edges_together_give_the_same_as_each_edge_alone(first):
    rng = np.random.default_rng(first)
    x, edge, number, out = rows(20), rng.integers(0, 20, (9, 2), np.uint32), rng.normal(size=20), rows(6)
    x[:, :3] = rng.normal(size=(20, 3))
    of_four_edges(x, edge, np.uint64(first), number, out)
    four = slice(first, first + 4)
    i, j = edge[four].T
    own, other = number[four], number[j]
    np.testing.assert_array_equal(out[1, :3], out[0, :3])
    expected = [(x[i] * x[j]).sum(axis=1), own, other, own / other, np.where(own > other, own, 7.0)]
    np.testing.assert_allclose(out[[0, 2, 3, 4, 5]], expected, rtol=0, atol=1e-13)


@njit
def ends_of(a):
    return ends(a, 0)


@pytest.mark.parametrize(
    "wrong", [np.zeros((4, 2), np.int32), np.zeros(8, np.uint32), np.zeros((2, 4), np.uint32).T]
)
def test_edge_ends_must_be_unsigned_pairs(wrong):
    with pytest.raises(TypingError, match="uint32"):
        ends_of(wrong)
