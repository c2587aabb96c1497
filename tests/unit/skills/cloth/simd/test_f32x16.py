"""Sixteen single-precision lanes against numpy, and common corners against sets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from numba.core.errors import TypingError

from foldcell.skills.cloth.contact.corners import common_corner
from foldcell.skills.cloth.simd.f32x16 import (
    expect_columns,
    expect_rows,
    load_f32x16,
    mask_less_equal,
    permute,
    splat_f32x16,
    store_f32x16,
    vabs,
    vmax,
    vmin,
    vsqrt,
    where,
)
from foldcell.skills.cloth.simd.i32x16 import (
    LANES,
    compress,
    iota,
    load_i32x16,
    mask_greater,
    mask_not_equal,
    popcount,
    splat_i32x16,
    store_i32x16,
    store_interleaved,
    vmax_i32x16,
    vmin_i32x16,
)
from foldcell.skills.cloth.simd.vec3 import load, store_singles
from tests.builders.cloth import call, rows

OPERATIONS = {  # of two registers, and of two arrays
    "add": (lambda a, b: a + b, np.add), "subtract": (lambda a, b: a - b, np.subtract),
    "multiply": (lambda a, b: a * b, np.multiply), "divide": (lambda a, b: a / b, np.divide),
    "absolute": (lambda a, b: vabs(a), lambda a, b: np.abs(a)), "least": (lambda a, b: vmin(a, b), np.minimum),
    "largest": (lambda a, b: vmax(a, b), np.maximum),
    "root": (lambda a, b: vsqrt(vabs(a)), lambda a, b: np.sqrt(np.abs(a))),
    "splat": (lambda a, b: splat_f32x16(np.float32(0.7)), lambda a, b: np.full(LANES, 0.7)),
}  # fmt: skip


def bits_of(given, operation):
    """Bit k is set if the result of the operation on the first two rows is not above the third row in lane k."""
    compiled = njit(operation)
    return njit(
        lambda x: mask_less_equal(compiled(load_f32x16(x, 0, 0), load_f32x16(x, 0, 1)), load_f32x16(x, 1, 0))
    )(given)


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_agree_with_numpy(name):
    """Results are compared with limits just above and just below the expected values."""
    operation, of_arrays = OPERATIONS[name]
    rng, given = np.random.default_rng(list(OPERATIONS).index(name)), np.zeros((2, 2, LANES), np.float32)
    given[0] = rng.normal(size=(2, LANES))
    expected = of_arrays(*given[0]).astype(np.float32)
    above = rng.random(LANES) < 0.5
    given[1, 0] = expected + np.where(above, 1e-5, -1e-5) * (1.0 + np.abs(expected))
    assert bits_of(given, operation) == (above << np.arange(LANES)).sum()


def test_equal_numbers_do_not_compare_as_greater():
    assert bits_of(np.ones((2, 2, LANES), np.float32), lambda a, b: vmin(a, b)) == 2**LANES - 1


@pytest.mark.parametrize("wrong", [np.zeros((2, 2, LANES)), np.zeros((2, LANES), np.float32)])
def test_arrays_of_another_type_or_layout_are_refused(wrong):
    with pytest.raises(TypingError, match="C-ordered"):
        njit(lambda a: mask_less_equal(load_f32x16(a, 0, 0), load_f32x16(a, 0, 0)))(wrong)


@njit
def choose(given, which, bits, out):
    a, b = load_f32x16(given, 0, 0), load_f32x16(given, 0, 1)
    store_f32x16(out, 1, 0, permute(a, load_i32x16(which, 0, 0)))
    store_f32x16(out, 1, 2, where(bits, a, b))


@pytest.mark.parametrize("bits", [0, 1, 0b1010011100101, 2**LANES - 1])
def test_permute_and_select_agree_with_numpy(bits):
    rng = np.random.default_rng(bits)
    given, out = rng.normal(size=(1, 2, LANES)).astype(np.float32), np.zeros((2, 3, LANES), np.float32)
    which = rng.integers(0, 3 * LANES, (1, 1, LANES)).astype(np.int32)
    choose(given, which, np.int32(bits), out)
    np.testing.assert_array_equal(out[1, 0], given[0, 0, which[0, 0] % LANES])
    np.testing.assert_array_equal(out[1, 2], np.where(bits >> np.arange(LANES) & 1, *given[0]))
    assert not out[0].any() and not out[1, 1].any()


@njit
def put_whole_numbers(given, bits, flat, pairs):
    a, b = load_i32x16(given, 0, 0), load_i32x16(given, 0, 1)
    store_i32x16(flat, 2, compress(a, bits))
    store_interleaved(pairs, 3, vmin_i32x16(a, b), vmax_i32x16(iota(np.int32(5)), splat_i32x16(given[0, 0, 1])))
    return mask_greater(a, b), mask_not_equal(a, b), popcount(bits)


@pytest.mark.parametrize("bits", [0, 1, 2 ** (LANES - 1), 0b1010011100101, 2**LANES - 1])
def test_integer_comparison_and_store_agree_with_numpy(bits):
    given = np.random.default_rng(bits).integers(-3, 20, (1, 2, LANES)).astype(np.int32)
    a, b = given[0]
    flat, pairs = np.full(LANES + 4, -9, np.int32), np.full((LANES + 4, 2), -9, np.int32)
    larger, other, n = put_whole_numbers(given, np.int32(bits), flat, pairs)
    place = np.arange(LANES)
    chosen = a[(bits >> place) % 2 == 1]
    assert larger == ((a > b) << place).sum() and other == ((a != b) << place).sum() and n == len(chosen)
    np.testing.assert_array_equal(flat[2 : 2 + n], chosen)
    np.testing.assert_array_equal(pairs[3:-1], np.column_stack([np.minimum(a, b), np.maximum(5 + place, a[1])]))
    assert (flat[[0, 1, -2, -1]] == -9).all() and (pairs[[0, 1, 2, -1]] == -9).all()


@pytest.mark.parametrize("wrong", [np.zeros((2, 2, LANES)), np.zeros((2, LANES), np.int32)])
def test_integer_arrays_of_another_type_or_layout_are_refused(wrong):
    with pytest.raises(TypingError, match="C-ordered"):
        njit(lambda a: mask_not_equal(load_i32x16(a, 0, 0), load_i32x16(a, 0, 0)))(wrong)


def test_arrays_of_another_shape_are_refused():
    call(expect_rows, np.zeros((5, 3, LANES)), 3)
    call(expect_columns, np.zeros((5, 3)), 3)
    for wrong in ((5, 4, LANES), (5, 3, LANES - 1)):
        with pytest.raises(ValueError, match="rows of lanes"):
            call(expect_rows, np.zeros(wrong), 3)
    with pytest.raises(ValueError, match="columns"):
        call(expect_columns, np.zeros((5, 4)), 3)


@njit
def shared(rows, i, j):
    return common_corner(rows, i, j)


CORNERS = st.lists(st.integers(0, 8), min_size=3, max_size=3, unique=True)


@given(CORNERS, CORNERS)
def test_common_corners_of_triangles_agree_with_sets(one, other):
    """The first number of a row is not a corner."""
    rows, common = np.array([[0, *one], [0, *other]], np.uint32), bool({*one} & {*other})
    assert shared(rows, 0, 1) == common
    wide = np.zeros((2, 16), np.uint32)  # numbers after the fourth are not corners either
    wide[:, :4] = rows
    assert shared(wide, 0, 1) == common


@njit
def put_down(given, out, at, step):
    store_singles(out, at, step, load(given, 0))


def test_a_vector_is_stored_in_single_precision():
    given, out = rows(1), np.zeros(12, np.float32)
    given[0, :3] = 1.1, -2.2, 3.3
    put_down(given, out, 2, 4)
    expected = np.zeros(12, np.float32)
    expected[[2, 6, 10]] = given[0, :3]
    np.testing.assert_array_equal(out, expected)
