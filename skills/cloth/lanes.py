# mypy: allow-untyped-defs, allow-incomplete-defs
"""LANES single precision numbers as one register, for compiled code.

`load_lanes(a, i, j)` reads a[i, j] of an array (m, k, LANES) of singles, `all_lanes(s)` is s in every place;
a + b, a - b, a * b, a / b, `size` (absolute value), `least`, `most` compute place by place, and
`not_above(a, b)` is a bit for each place where a <= b; `lowest` finds the first of them. Written as loops the same
became instructions half as wide, between which bits were collected one by one. Products and sums may be
contracted, as everywhere in the solver. That the last axis of an array is LANES long nothing checks.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError
from numba.cpython.unsafe.numbers import trailing_zeros
from numba.extending import models, overload, register_model

from skills.cloth.registers import elementwise, operation, place_of

__all__ = ["LANES", "all_lanes", "least", "load_lanes", "lowest", "most", "not_above", "size"]

LANES = 16
_REGISTER = ir.VectorType(ir.FloatType(), LANES)
_WHOLE = ir.VectorType(ir.IntType(32), LANES)
_FLAGS = ("contract", "nnan", "nsz")

# place of the lowest bit of a number; an intrinsic of numba's, which its own sets use
lowest: Any = trailing_zeros


class _Lanes(types.Type):
    pass


_lanes = _Lanes(name="Lanes")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)  # type: ignore[no-untyped-call]


@operation
def load_lanes(typingctx, array, i, j):
    """a[i, j] of an array (m, k, LANES)."""
    fits = isinstance(array, types.Array) and array.ndim == 3 and array.dtype == types.float32
    if not fits or array.layout != "C":
        raise TypingError(f"lanes are rows of a C-ordered array (m, k, {LANES}) of singles, not of {array}")

    def generate(context, builder, signature, arguments):
        place = [*arguments[1:], context.get_constant(types.intp, 0)]
        pointer = place_of(context, builder, signature.args[0], arguments[0], place, _REGISTER)
        return builder.load(pointer, typ=_REGISTER, align=4)

    return _lanes(array, types.intp, types.intp), generate


@operation
def all_lanes(typingctx, s):
    """s in every place."""

    def generate(context, builder, signature, arguments):
        empty = ir.Constant(_REGISTER, ir.Undefined)
        first = builder.insert_element(empty, arguments[0], ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(first, empty, ir.Constant(_WHOLE, [0] * LANES))

    return _lanes(types.float32), generate


_plus, _minus, _times, _over = (elementwise(_lanes, name, _FLAGS) for name in ("fadd", "fsub", "fmul", "fdiv"))


def _chosen(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            first = builder.fcmp_ordered(sign, *arguments, flags=_FLAGS)
            return builder.select(first, *arguments)

        return _lanes(_lanes, _lanes), generate

    return apply


least, most = _chosen("<"), _chosen(">")


@operation
def size(typingctx, a):
    """|a|"""

    def generate(context, builder, signature, arguments):
        bits = builder.and_(builder.bitcast(arguments[0], _WHOLE), ir.Constant(_WHOLE, [0x7FFFFFFF] * LANES))
        return builder.bitcast(bits, _REGISTER)

    return _lanes(_lanes), generate


@operation
def not_above(typingctx, a, b):
    """A bit for each place where a <= b."""

    def generate(context, builder, signature, arguments):
        met = builder.fcmp_ordered("<=", *arguments, flags=_FLAGS)
        return builder.zext(builder.bitcast(met, ir.IntType(LANES)), ir.IntType(32))

    return types.int32(_lanes, _lanes), generate


def _give(operation: Any, function: Any) -> None:
    @overload(operation)
    def apply(a, b):
        if a == _lanes and b == _lanes:
            return lambda a, b: function(a, b)
        return None


for _sign, _function in (
    (operator.add, _plus), (operator.sub, _minus), (operator.mul, _times), (operator.truediv, _over)
):  # fmt: skip
    _give(_sign, _function)
