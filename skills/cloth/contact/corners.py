# mypy: allow-untyped-defs, allow-incomplete-defs
"""Compares the corners of two triangles in one register each, for compiled code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError

from skills.cloth.simd.intrinsics import operation, place_of

__all__ = ["common_corner"]

_INDEX = ir.IntType(32)
_ROW = ir.VectorType(_INDEX, 4)
_ANY = ir.IntType(4)


@operation
def common_corner(typingctx, array, i, j):
    """Return whether rows i and j of an array (n, 4 or more) of 32-bit integers have a number in common in columns
    1 to 3.

    Nine successive comparisons would be nine branches to predict.
    """
    fits = isinstance(array, types.Array) and array.ndim == 2 and array.dtype in (types.int32, types.uint32)
    if not fits or array.layout != "C":
        raise TypingError(
            f"corners are rows of a C-ordered array (n, 4 or more) of 32-bit integers, not of {array}"
        )

    def generate(context, builder, signature, arguments):
        def corners(i: Any) -> Any:
            place = [i, context.get_constant(types.intp, 0)]
            pointer = place_of(context, builder, signature.args[0], arguments[0], place, _ROW)
            return builder.load(pointer, typ=_ROW, align=4)

        def turned(row: Any, order: list[int]) -> Any:
            return builder.shuffle_vector(row, ir.Constant(_ROW, ir.Undefined), ir.Constant(_ROW, order))

        one, other = turned(corners(arguments[1]), [1, 2, 3, 1]), corners(arguments[2])
        same = [
            builder.icmp_unsigned("==", one, turned(other, order))
            for order in ([1, 2, 3, 1], [2, 3, 1, 2], [3, 1, 2, 3])
        ]
        some = builder.bitcast(builder.or_(builder.or_(same[0], same[1]), same[2]), _ANY)
        return builder.icmp_unsigned("!=", some, ir.Constant(_ANY, 0))

    return types.boolean(array, types.intp, types.intp), generate
