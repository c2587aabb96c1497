# mypy: allow-untyped-defs, allow-incomplete-defs
"""LANES single precision numbers, or as many whole ones, as one register, for compiled code.

`load_lanes(a, i, j)` reads a[i, j] of an array (m, k, LANES) of singles, `all_lanes(s)` is s in every place;
a + b, a - b, a * b, a / b, `size` (absolute value), `least`, `most` compute place by place, and
`not_above(a, b)` is a bit for each place where a <= b; `lowest` finds the first of them. Written as loops the same
became instructions half as wide, between which bits were collected one by one. Products and sums may be
contracted, as everywhere in the solver.

Of whole numbers `load_whole` and `all_whole` are the same; `places(s)` is s, s + 1, ..., `lesser` and `greater`
choose, `above` and `differ` compare. `packed(a, bits)` are those that bits tell, side by side, which `put_whole`
and `put_pairs` write down, LANES at once; then `how_many(bits)` are valid. So what bits tell is put down without
a branch: how many there are would be guessed at, and often wrongly.

That the last axis of an array is LANES long, and that there is room for all that is written, nothing checks.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.cpython.unsafe.numbers import trailing_zeros
from numba.extending import models, overload, register_model

from skills.cloth.registers import elementwise, operation, place_of

__all__ = [
    "LANES", "above", "all_lanes", "all_whole", "differ", "expect_columns", "expect_rows", "greater", "how_many",
    "least", "lesser", "load_lanes", "load_whole", "lowest", "most", "not_above", "packed", "places", "put_pairs",
    "put_whole", "size",
]  # fmt: skip

LANES = 16
_REGISTER = ir.VectorType(ir.FloatType(), LANES)
_WHOLE = ir.VectorType(ir.IntType(32), LANES)
_FLAGS = ("contract", "nnan", "nsz")

# place of the lowest bit of a number; an intrinsic of numba's, which its own sets use
lowest: Any = trailing_zeros


class _Lanes(types.Type):
    pass


_lanes = _Lanes(name="Lanes")


class _Whole(types.Type):
    pass


_whole = _Whole(name="Whole")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)  # type: ignore[no-untyped-call]


@register_model(_Whole)
class _WholeModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _WHOLE)  # type: ignore[no-untyped-call]


def _everywhere(builder: Any, register: Any, s: Any) -> Any:
    """A register with s in every place."""
    empty = ir.Constant(register, ir.Undefined)
    first = builder.insert_element(empty, s, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, empty, ir.Constant(_WHOLE, [0] * LANES))


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
        return _everywhere(builder, _REGISTER, arguments[0])

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


def _check_whole(array: Any, dimensions: int) -> None:
    """That it can hold whole numbers side by side; whether they have a sign does not matter."""
    fits = isinstance(array, types.Array) and array.ndim == dimensions and array.layout == "C"
    if not fits or array.dtype not in (types.int32, types.uint32):
        raise TypingError(f"whole numbers are in C-ordered arrays of {dimensions} axes of int32, not in {array}")


@operation
def load_whole(typingctx, array, i, j):
    """a[i, j] of an array (m, k, LANES)."""
    _check_whole(array, 3)

    def generate(context, builder, signature, arguments):
        place = [*arguments[1:], context.get_constant(types.intp, 0)]
        pointer = place_of(context, builder, signature.args[0], arguments[0], place, _WHOLE)
        return builder.load(pointer, typ=_WHOLE, align=4)

    return _whole(array, types.intp, types.intp), generate


@operation
def all_whole(typingctx, s):
    """s in every place."""

    def generate(context, builder, signature, arguments):
        return _everywhere(builder, _WHOLE, arguments[0])

    return _whole(types.int32), generate


@operation
def places(typingctx, first):
    """first, first + 1, first + 2, ..."""

    def generate(context, builder, signature, arguments):
        first = _everywhere(builder, _WHOLE, arguments[0])
        return builder.add(first, ir.Constant(_WHOLE, list(range(LANES))))

    return _whole(types.int32), generate


@operation
def packed(typingctx, a, bits):
    """Those of a with a bit, side by side from the first place on; what is behind them is not set."""

    def generate(context, builder, signature, arguments):
        flags = ir.VectorType(ir.IntType(1), LANES)
        mask = builder.bitcast(builder.trunc(arguments[1], ir.IntType(LANES)), flags)
        kind = ir.FunctionType(_WHOLE, [_WHOLE, flags, _WHOLE])
        name = f"llvm.experimental.vector.compress.v{LANES}i32"
        compress = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(compress, [arguments[0], mask, ir.Constant(_WHOLE, ir.Undefined)])

    return _whole(_whole, types.int32), generate


@operation
def put_whole(typingctx, array, at, a):
    """a to places at, at + 1, ... of a flat array."""
    _check_whole(array, 1)

    def generate(context, builder, signature, arguments):
        pointer = place_of(context, builder, signature.args[0], arguments[0], [arguments[1]], _WHOLE)
        builder.store(arguments[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, _whole), generate


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

    return types.void(array, types.intp, _whole, _whole), generate


def _compared(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            met = builder.icmp_signed(sign, *arguments)
            return builder.zext(builder.bitcast(met, ir.IntType(LANES)), ir.IntType(32))

        return types.int32(_whole, _whole), generate

    return apply


def _selected(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            return builder.select(builder.icmp_signed(sign, *arguments), *arguments)

        return _whole(_whole, _whole), generate

    return apply


above, differ = _compared(">"), _compared("!=")  # a bit for each place where a > b, where a != b
lesser, greater = _selected("<"), _selected(">")


@operation
def how_many(typingctx, bits):
    """Bits that are set."""

    def generate(context, builder, signature, arguments):
        return builder.zext(builder.ctpop(arguments[0]), ir.IntType(64))

    return types.uint64(types.int32), generate


@njit(nogil=True, forceinline=True)
def expect_rows(array, k):
    """That an array is (m, k, LANES). The compiler knows it from here on: it finds places by constants then."""
    if array.shape[1] != k or array.shape[2] != LANES:
        raise ValueError("not an array of so many rows of lanes")


@njit(nogil=True, forceinline=True)
def expect_columns(array, k):
    """The same of an array (m, k)."""
    if array.shape[1] != k:
        raise ValueError("not an array of so many columns")
