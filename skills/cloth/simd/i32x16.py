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
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import models, register_model

from skills.cloth.simd.intrinsics import load_of, operation, place_of, splat, splat_of

__all__ = [
    "LANES",
    "WHOLE",
    "compress",
    "flags",
    "iota",
    "load_i32x16",
    "mask_greater",
    "mask_not_equal",
    "popcount",
    "splat_i32x16",
    "store_i32x16",
    "store_interleaved",
    "vmax_i32x16",
    "vmin_i32x16",
    "whole",
]  # fmt: skip

LANES = 16
WHOLE = ir.VectorType(ir.IntType(32), LANES)


class _Whole(types.Type):
    pass


whole = _Whole(name="Whole")


@register_model(_Whole)
class _WholeModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, WHOLE)  # type: ignore[no-untyped-call]


def _check_whole(array: Any, dimensions: int) -> None:
    """Accept C-ordered int32 and uint32 arrays."""
    fits = isinstance(array, types.Array) and array.ndim == dimensions and array.layout == "C"
    if not fits or array.dtype not in (types.int32, types.uint32):
        raise TypingError(f"whole numbers are in C-ordered arrays of {dimensions} axes of int32, not in {array}")


def _check_rows(array: Any) -> None:
    _check_whole(array, 3)


load_i32x16 = load_of(whole, WHOLE, _check_rows)  # reads a[i, j] of an array (m, k, LANES)
splat_i32x16 = splat_of(whole, WHOLE, types.int32)


@operation
def iota(typingctx, first):
    """Return a register with first, first + 1, first + 2, ..."""

    def generate(context, builder, signature, arguments):
        first = splat(builder, WHOLE, arguments[0])
        return builder.add(first, ir.Constant(WHOLE, list(range(LANES))))

    return whole(types.int32), generate


def flags(builder: Any, bits: Any) -> Any:
    """Convert the bits to a register of booleans."""
    return builder.bitcast(builder.trunc(bits, ir.IntType(LANES)), ir.VectorType(ir.IntType(1), LANES))


@operation
def compress(typingctx, a, bits):
    """Move the lanes of a whose bit is set to the front; the lanes behind them are undefined."""

    def generate(context, builder, signature, arguments):
        mask = flags(builder, arguments[1])
        kind = ir.FunctionType(WHOLE, [WHOLE, mask.type, WHOLE])
        name = f"llvm.experimental.vector.compress.v{LANES}i32"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [arguments[0], mask, ir.Constant(WHOLE, ir.Undefined)])

    return whole(whole, types.int32), generate


@operation
def store_i32x16(typingctx, array, at, a):
    """Store the lanes of a at indices at, at + 1, ... of a flat array."""
    _check_whole(array, 1)

    def generate(context, builder, signature, arguments):
        pointer = place_of(context, builder, signature.args[0], arguments[0], [arguments[1]], WHOLE)
        builder.store(arguments[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, whole), generate


@operation
def store_interleaved(typingctx, array, at, a, b):
    """Store the pairs (a[k], b[k]) in rows at, at + 1, ... of an array (n, 2)."""
    _check_whole(array, 2)

    def generate(context, builder, signature, arguments):
        both = ir.VectorType(ir.IntType(32), 2 * LANES)
        order = [k // 2 + LANES * (k % 2) for k in range(2 * LANES)]
        pairs = builder.shuffle_vector(arguments[2], arguments[3], ir.Constant(both, order))
        place = [arguments[1], context.get_constant(types.intp, 0)]
        pointer = place_of(context, builder, signature.args[0], arguments[0], place, both)
        builder.store(pairs, pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, whole, whole), generate


def _compared(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            met = builder.icmp_signed(sign, *arguments)
            return builder.zext(builder.bitcast(met, ir.IntType(LANES)), ir.IntType(32))

        return types.int32(whole, whole), generate

    return apply


def _selected(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            return builder.select(builder.icmp_signed(sign, *arguments), *arguments)

        return whole(whole, whole), generate

    return apply


# integers whose bit k is set if a > b, or a != b, in lane k
mask_greater, mask_not_equal = _compared(">"), _compared("!=")
vmin_i32x16, vmax_i32x16 = _selected("<"), _selected(">")


@operation
def popcount(typingctx, bits):
    """Return the number of bits that are set."""

    def generate(context, builder, signature, arguments):
        return builder.zext(builder.ctpop(arguments[0]), ir.IntType(64))

    return types.uint64(types.int32), generate
