# mypy: allow-untyped-defs, allow-incomplete-defs
"""Compares the corners of two triangles in one register each, for compiled code."""

from __future__ import annotations

from llvmlite import ir
from numba import types

from foldcell.skills.cloth.simd.registers import INDEX, ArrayOf, mixed, operation

_ROW, _ANY = ir.VectorType(INDEX, 4), ir.IntType(4)


@operation(types.boolean, ArrayOf(2, (types.int32, types.uint32)), types.intp, types.intp)
def common_corner(builder, array, i, j):
    """Return whether rows i and j of an array (n, 4 or more) of 32-bit integers have a number in common in columns
    1 to 3.

    Nine successive comparisons would be nine branches to predict.
    """
    one, other = (array.load(array.at((row, 0), _ROW)) for row in (i, j))
    first = mixed(builder, one, one, [1, 2, 3, 1])
    second, third, fourth = (
        builder.icmp_unsigned("==", first, mixed(builder, other, other, order))
        for order in ([1, 2, 3, 1], [2, 3, 1, 2], [3, 1, 2, 3])
    )
    some = builder.bitcast(builder.or_(builder.or_(second, third), fourth), _ANY)
    return builder.icmp_unsigned("!=", some, ir.Constant(_ANY, 0))
