# mypy: allow-untyped-defs, allow-incomplete-defs
"""LANES whole numbers as one register, for compiled code.

`load_whole(a, i, j)` reads a[i, j] of an array (m, k, LANES), `all_whole(s)` is s in every place, `places(s)` is
s, s + 1, ...; `lesser` and `greater` choose, `above` and `differ` compare: a bit for each place. `packed(a, bits)`
are those that bits tell, side by side, which `put_whole` and `put_pairs` write down, LANES at once; then
`how_many(bits)` are valid. So what bits tell is put down without a branch: how many there are would be guessed at,
and often wrongly.

That the last axis of an array is LANES long, and that there is room for all that is written, nothing checks.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import models, register_model

from skills.cloth.simd.intrinsics import everywhere, everywhere_of, load_of, operation, place_of

__all__ = [
    "LANES", "WHOLE", "above", "all_whole", "differ", "flags", "greater", "how_many", "lesser", "load_whole",
    "packed", "places", "put_pairs", "put_whole", "whole",
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
    """That it can hold whole numbers side by side; whether they have a sign does not matter."""
    fits = isinstance(array, types.Array) and array.ndim == dimensions and array.layout == "C"
    if not fits or array.dtype not in (types.int32, types.uint32):
        raise TypingError(f"whole numbers are in C-ordered arrays of {dimensions} axes of int32, not in {array}")


def _check_rows(array: Any) -> None:
    _check_whole(array, 3)


load_whole = load_of(whole, WHOLE, _check_rows)  # a[i, j] of an array (m, k, LANES)
all_whole = everywhere_of(whole, WHOLE, types.int32)


@operation
def places(typingctx, first):
    """first, first + 1, first + 2, ..."""

    def generate(context, builder, signature, arguments):
        first = everywhere(builder, WHOLE, arguments[0])
        return builder.add(first, ir.Constant(WHOLE, list(range(LANES))))

    return whole(types.int32), generate


def flags(builder: Any, bits: Any) -> Any:
    """The bits as a register of them."""
    return builder.bitcast(builder.trunc(bits, ir.IntType(LANES)), ir.VectorType(ir.IntType(1), LANES))


@operation
def packed(typingctx, a, bits):
    """Those of a with a bit, side by side from the first place on; what is behind them is not set."""

    def generate(context, builder, signature, arguments):
        mask = flags(builder, arguments[1])
        kind = ir.FunctionType(WHOLE, [WHOLE, mask.type, WHOLE])
        name = f"llvm.experimental.vector.compress.v{LANES}i32"
        compress = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(compress, [arguments[0], mask, ir.Constant(WHOLE, ir.Undefined)])

    return whole(whole, types.int32), generate


@operation
def put_whole(typingctx, array, at, a):
    """a to places at, at + 1, ... of a flat array."""
    _check_whole(array, 1)

    def generate(context, builder, signature, arguments):
        pointer = place_of(context, builder, signature.args[0], arguments[0], [arguments[1]], WHOLE)
        builder.store(arguments[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, whole), generate


@operation
def put_pairs(typingctx, array, at, a, b):
    """Places of a and b, side by side, to rows at, at + 1, ... of an array (n, 2)."""
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


above, differ = _compared(">"), _compared("!=")  # a bit for each place where a > b, where a != b
lesser, greater = _selected("<"), _selected(">")


@operation
def how_many(typingctx, bits):
    """Bits that are set."""

    def generate(context, builder, signature, arguments):
        return builder.zext(builder.ctpop(arguments[0]), ir.IntType(64))

    return types.uint64(types.int32), generate
