# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of LANES (16) single precision numbers in one register, for compiled code.

`load_f32x16(a, i, j)` reads a[i, j] of a float32 array (m, k, LANES) and `store_f32x16` writes it.
`splat_f32x16(s)` returns a register with s in every lane. a + b, a - b, a * b, a / b, `vabs`, `vsqrt`, `vmin` and
`vmax` work lane by lane. In `permute(a, i)`, lane k of the result is lane i[k] of a, where i is a register of
integers (i32x16.py). `mask_less_equal(a, b)` returns an integer whose bit k is set if a <= b in lane k.
`where(bits, a, b)` takes the lanes whose bit is set from a and the others from b, and `ctz(bits)` returns the
position of the lowest set bit. If the same code were written as loops, it would compile to instructions that are
half as wide and that collect the bits one by one. The compiler may contract products and sums (fused
multiply-add), as everywhere in the solver.

Nothing checks that the last axis of an array has LANES elements.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.cpython.unsafe.numbers import trailing_zeros

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.i32x16 import LANES, flags, whole
from foldcell.skills.cloth.simd.registers import (
    INDEX,
    Register,
    call,
    choose,
    load_rows,
    mask_where,
    operation,
    splat_of,
    store_rows,
)

_lanes = Register(types.float32, LANES, ("contract", "nnan", "nsz"))

# ctz(bits): position of the lowest bit that is set (an internal intrinsic of numba)
ctz: Any = trailing_zeros

# read and write a[i, j] of an array (m, k, LANES)
load_f32x16, store_f32x16 = load_rows(_lanes, types.float32), store_rows(_lanes, types.float32)
splat_f32x16, mask_less_equal = splat_of(_lanes), mask_where(_lanes, "<=")
vmin, vmax = choose(_lanes, "<"), choose(_lanes, ">")


@operation(_lanes, _lanes)
def vsqrt(builder, a):
    """Return the square root of each lane."""
    return call(builder, "sqrt", a)


@operation(_lanes, _lanes)
def vabs(builder, a):
    """Return |a| in each lane."""
    bits = builder.and_(builder.bitcast(a, whole.llvm), ir.Constant(whole.llvm, [0x7FFFFFFF] * LANES))
    return builder.bitcast(bits, a.type)


@operation(_lanes, _lanes, whole)
def permute(builder, a, i):
    """Return a register whose lane k is lane i[k] of a; i[k] is taken modulo LANES."""
    # in this form the compiler emits a single instruction, if the processor has one
    i = builder.and_(i, ir.Constant(whole.llvm, [LANES - 1] * LANES))
    made = ir.Constant(a.type, ir.Undefined)
    for k in range(LANES):
        place = ir.Constant(INDEX, k)
        made = builder.insert_element(made, builder.extract_element(a, builder.extract_element(i, place)), place)
    return made


@operation(_lanes, types.int32, _lanes, _lanes)
def where(builder, bits, a, b):
    """Take the lanes whose bit is set from a, the other lanes from b."""
    return builder.select(flags(builder, bits), a, b)


@inner(forceinline=True)
def expect_rows(array, k):
    """Check that an array has the shape (m, k, LANES), so that the compiler can compute offsets from constants."""
    if array.shape[1] != k or array.shape[2] != LANES:
        raise ValueError("not an array of so many rows of lanes")


@inner(forceinline=True)
def expect_columns(array, k):
    """Check that an array has the shape (m, k), so that the compiler can compute offsets from constants."""
    if array.shape[1] != k:
        raise ValueError("not an array of so many columns")
