# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of LANES (16) integers of 32 bits in one register, for compiled code.

`load_i32x16(a, i, j)` reads a[i, j] of an array (m, k, LANES). `splat_i32x16(s)` returns a register with s in
every lane, `iota(s)` returns a register with s, s + 1, ... `vmin_i32x16` and `vmax_i32x16` work lane by lane.
`mask_greater` and `mask_not_equal` compare two registers and return an integer with one bit per lane. `compress(a,
bits)` moves the lanes whose bit is set to the front. `store_i32x16` and `store_interleaved` then write all LANES
together, of which the first `popcount(bits)` are valid. Selected values are thus written without a branch, which
the processor would often predict wrongly.

Nothing checks that the last axis of an array has LANES elements, nor that there is room for all lanes that are
written.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from foldcell.skills.cloth.simd.registers import (
    ArrayOf,
    Register,
    call,
    choose,
    load_rows,
    mask_where,
    mixed,
    operation,
    splat,
    splat_of,
)

LANES = 16
INTEGERS = types.int32, types.uint32  # of the arrays
whole = Register(types.int32, LANES)

load_i32x16, splat_i32x16 = load_rows(whole, *INTEGERS), splat_of(whole)
vmin_i32x16, vmax_i32x16 = choose(whole, "<"), choose(whole, ">")
mask_greater, mask_not_equal = mask_where(whole, ">"), mask_where(whole, "!=")


@operation(whole, types.int32)
def iota(builder, first):
    """Return a register with first, first + 1, first + 2, ..."""
    return builder.add(splat(builder, whole.llvm, first), ir.Constant(whole.llvm, list(range(LANES))))


def flags(builder: Any, bits: Any) -> Any:
    """Convert the bits to a register of booleans."""
    return builder.bitcast(builder.trunc(bits, ir.IntType(LANES)), ir.VectorType(ir.IntType(1), LANES))


@operation(whole, whole, types.int32)
def compress(builder, a, bits):
    """Move the lanes of a whose bit is set to the front; the lanes behind them are undefined."""
    nothing = ir.Constant(whole.llvm, ir.Undefined)
    return call(builder, "experimental.vector.compress", a, flags(builder, bits), nothing)


@operation(types.void, ArrayOf(1, INTEGERS), types.intp, whole)
def store_i32x16(builder, array, at, a):
    """Store the lanes of a at indices at, at + 1, ... of a flat array."""
    array.store(a, array.at((at,), whole.llvm))


@operation(types.void, ArrayOf(2, INTEGERS), types.intp, whole, whole)
def store_interleaved(builder, array, at, a, b):
    """Store the pairs (a[k], b[k]) in rows at, at + 1, ... of an array (n, 2)."""
    pairs = mixed(builder, a, b, [k // 2 + LANES * (k % 2) for k in range(2 * LANES)])
    array.store(pairs, array.at((at, 0), pairs.type))


@operation(types.uint64, types.int32)
def popcount(builder, bits):
    """Return the number of bits that are set."""
    return builder.zext(builder.ctpop(bits), ir.IntType(64))
