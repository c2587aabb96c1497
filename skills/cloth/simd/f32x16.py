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

import operator
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.cpython.unsafe.numbers import trailing_zeros
from numba.extending import models, overload, register_model

from skills.cloth.simd.i32x16 import LANES, WHOLE, flags, whole
from skills.cloth.simd.intrinsics import elementwise, load_of, operation, splat_of, store_of

__all__ = [
    "LANES",
    "ctz",
    "expect_columns",
    "expect_rows",
    "load_f32x16",
    "mask_less_equal",
    "permute",
    "splat_f32x16",
    "store_f32x16",
    "vabs",
    "vmax",
    "vmin",
    "vsqrt",
    "where",
]  # fmt: skip

_REGISTER = ir.VectorType(ir.FloatType(), LANES)
_FLAGS = ("contract", "nnan", "nsz")

# ctz(bits): position of the lowest bit that is set (an internal intrinsic of numba)
ctz: Any = trailing_zeros


class _Lanes(types.Type):
    pass


_lanes = _Lanes(name="Lanes")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)  # type: ignore[no-untyped-call]


def _check_singles(array: Any) -> None:
    fits = isinstance(array, types.Array) and array.ndim == 3 and array.dtype == types.float32
    if not fits or array.layout != "C":
        raise TypingError(f"lanes are rows of a C-ordered array (m, k, {LANES}) of singles, not of {array}")


# read and write a[i, j] of an array (m, k, LANES)
load_f32x16, store_f32x16 = load_of(_lanes, _REGISTER, _check_singles), store_of(_lanes, _REGISTER, _check_singles)
splat_f32x16 = splat_of(_lanes, _REGISTER, types.float32)
_plus, _minus, _times, _div = (elementwise(_lanes, name, _FLAGS) for name in ("fadd", "fsub", "fmul", "fdiv"))


def _chosen(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            first = builder.fcmp_ordered(sign, *arguments, flags=_FLAGS)
            return builder.select(first, *arguments)

        return _lanes(_lanes, _lanes), generate

    return apply


vmin, vmax = _chosen("<"), _chosen(">")


@operation
def vsqrt(typingctx, a):
    """Return the square root of each lane."""

    def generate(context, builder, signature, arguments):
        kind = ir.FunctionType(_REGISTER, [_REGISTER])
        return builder.call(
            cgutils.get_or_insert_function(builder.module, kind, f"llvm.sqrt.v{LANES}f32"), arguments
        )

    return _lanes(_lanes), generate


@operation
def vabs(typingctx, a):
    """Return |a| in each lane."""

    def generate(context, builder, signature, arguments):
        bits = builder.and_(builder.bitcast(arguments[0], WHOLE), ir.Constant(WHOLE, [0x7FFFFFFF] * LANES))
        return builder.bitcast(bits, _REGISTER)

    return _lanes(_lanes), generate


@operation
def mask_less_equal(typingctx, a, b):
    """Return an integer whose bit k is set if a <= b in lane k."""

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
    (operator.add, _plus), (operator.sub, _minus), (operator.mul, _times), (operator.truediv, _div)
):  # fmt: skip
    _give(_sign, _function)


@operation
def permute(typingctx, a, i):
    """Return a register whose lane k is lane i[k] of a; i[k] is taken modulo LANES."""

    def generate(context, builder, signature, arguments):
        # in this form the compiler emits a single instruction, if the processor has one
        a, i = arguments
        i = builder.and_(i, ir.Constant(WHOLE, [LANES - 1] * LANES))
        made = ir.Constant(_REGISTER, ir.Undefined)
        for k in range(LANES):
            place = ir.Constant(ir.IntType(32), k)
            made = builder.insert_element(
                made, builder.extract_element(a, builder.extract_element(i, place)), place
            )
        return made

    return _lanes(_lanes, whole), generate


@operation
def where(typingctx, bits, a, b):
    """Take the lanes whose bit is set from a, the other lanes from b."""

    def generate(context, builder, signature, arguments):
        return builder.select(flags(builder, arguments[0]), *arguments[1:])

    return _lanes(types.int32, _lanes, _lanes), generate


@njit(nogil=True, forceinline=True)
def expect_rows(array, k):
    """Check that an array has the shape (m, k, LANES), so that the compiler can compute offsets from constants."""
    if array.shape[1] != k or array.shape[2] != LANES:
        raise ValueError("not an array of so many rows of lanes")


@njit(nogil=True, forceinline=True)
def expect_columns(array, k):
    """Check that an array has the shape (m, k), so that the compiler can compute offsets from constants."""
    if array.shape[1] != k:
        raise ValueError("not an array of so many columns")
