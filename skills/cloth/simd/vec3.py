# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of a point or direction, one register of four doubles, for compiled code.

Arrays of vectors have four columns (`rows` allocates them); the fourth column is always zero. `load` reads a row
and `store` writes it; `store_singles` stores a vector in single precision. `vector(x, y, z)` makes a vector. a +
b, a - b, -a, s * a (s a float), `dot` and `cross` compute with vectors. A row of four weights is not a vector but
can be loaded like one: `spread` then returns four registers, each with one weight in every lane, and a * b
multiplies such a register with a vector. `members` reads the four vertices that the weights belong to. The
compiler may contract products and sums (fused multiply-add), as everywhere in the solver. Nothing checks the
number of columns: an array with fewer than four would be read and written beyond its rows.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core.errors import TypingError
from numba.extending import models, overload, register_model

from robots.ports import Array
from skills.cloth.simd.aligned_arrays import aligned_zeros
from skills.cloth.simd.intrinsics import elementwise, operation, place_of, splat_of

__all__ = [
    "WIDTH", "cross", "dot", "load", "members", "rows", "spread", "store", "store_singles", "vector",
    "vector_type",
]  # fmt: skip

WIDTH = 4
_REGISTER = ir.VectorType(ir.DoubleType(), WIDTH)
_INDEX, _SINGLE = ir.IntType(32), ir.FloatType()
_FLAGS = ("contract",)


class _Vector(types.Type):
    pass


vector_type = _vector = _Vector(name="Vector")


def _check(array: Any) -> None:
    """Check an array's Numba type: two axes, doubles and C order. The number of columns is not part of that type,
    so it is not checked. Raises TypingError."""
    fits = isinstance(array, types.Array) and array.ndim == 2 and array.dtype == types.float64
    if not fits or array.layout != "C":
        raise TypingError(f"vectors are rows of a C-ordered array (n, {WIDTH}) of doubles, not of {array}")


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)  # type: ignore[no-untyped-call]


def rows(n: int) -> Array:
    """Return zeros (n, WIDTH) in which each row is within one cache line."""
    return aligned_zeros((n, WIDTH))


def _row(context: Any, builder: Any, kind: Any, array: Any, i: Any) -> Any:
    """Return a pointer to row i. The constant WIDTH saves a multiplication by the array's shape."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(builder.bitcast(data, ir.PointerType(_REGISTER)), [i])


@operation
def load(typingctx, array, i):
    """Read row i of an array (n, WIDTH)."""
    _check(array)

    def generate(context, builder, signature, arguments):
        read = builder.load(_row(context, builder, signature.args[0], *arguments), typ=_REGISTER)
        read.align = 8
        return read

    return _vector(array, types.intp), generate


@operation
def members(typingctx, array, i):
    """Read the four numbers in row i of an array (n, 4) of unsigned 32-bit integers."""
    fits = isinstance(array, types.Array) and array.ndim == 2 and array.dtype == types.uint32
    if not fits or array.layout != "C":
        raise TypingError(f"members are rows of a C-ordered array (n, 4) of unsigned integers, not of {array}")

    def generate(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        first = builder.mul(arguments[1], context.get_constant(types.intp, 4))
        read = [
            builder.load(builder.gep(data, [builder.add(first, context.get_constant(types.intp, k))]))
            for k in range(4)
        ]
        return context.make_tuple(builder, signature.return_type, read)

    return types.UniTuple(types.uint32, 4)(array, types.intp), generate


@operation
def store(typingctx, array, i, v):
    """Write v to row i of an array (n, WIDTH)."""
    _check(array)

    def generate(context, builder, signature, arguments):
        row = _row(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], row).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, _vector), generate


@operation
def store_singles(typingctx, array, at, step, v):
    """Store the three coordinates of v as singles at indices at, at + step and at + 2 step of a flat array."""
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.dtype == types.float32):
        raise TypingError(f"singles are written to a flat array of them, not to {array}")

    def generate(context, builder, signature, arguments):
        array, at, step, v = arguments
        singles = builder.fptrunc(v, ir.VectorType(_SINGLE, WIDTH))
        for k in range(3):
            value = builder.extract_element(singles, ir.Constant(_INDEX, k))
            builder.store(value, place_of(context, builder, signature.args[0], array, [at], _SINGLE))
            at = builder.add(at, step)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, _vector), generate


@operation
def vector(typingctx, x, y, z):
    """Make a vector of three floats."""

    def generate(context, builder, signature, arguments):
        made = ir.Constant(_REGISTER, [0.0] * WIDTH)
        for k, value in enumerate(arguments):
            made = builder.insert_element(made, value, ir.Constant(_INDEX, k))
        return made

    return _vector(types.float64, types.float64, types.float64), generate


_all = splat_of(_vector, _REGISTER, types.float64)
_plus, _minus, _times = (elementwise(_vector, name, _FLAGS) for name in ("fadd", "fsub", "fmul"))


@operation
def spread(typingctx, v):
    """Return four registers: register k has number k of v in all lanes."""

    def generate(context, builder, signature, arguments):
        def repeated(k: int) -> Any:
            order = ir.Constant(ir.VectorType(_INDEX, WIDTH), [k] * WIDTH)
            return builder.shuffle_vector(arguments[0], ir.Constant(_REGISTER, ir.Undefined), order)

        return context.make_tuple(builder, signature.return_type, [repeated(k) for k in range(WIDTH)])

    return types.UniTuple(_vector, WIDTH)(_vector), generate


@operation
def _turned(typingctx, v):
    """Return (y, z, x) of v = (x, y, z)."""

    def generate(context, builder, signature, arguments):
        order = ir.Constant(ir.VectorType(_INDEX, WIDTH), [1, 2, 0, 3])
        return builder.shuffle_vector(arguments[0], ir.Constant(_REGISTER, ir.Undefined), order)

    return _vector(_vector), generate


@operation
def dot(typingctx, a, b):
    """Return a . b."""

    def generate(context, builder, signature, arguments):
        products = builder.fmul(*arguments, flags=_FLAGS)
        x, y, z = (builder.extract_element(products, ir.Constant(_INDEX, k)) for k in range(3))
        return builder.fadd(builder.fadd(x, y, flags=_FLAGS), z, flags=_FLAGS)

    return types.float64(_vector, _vector), generate


@njit(nogil=True)
def cross(a, b):
    """Return a x b."""
    return _turned(_minus(_times(a, _turned(b)), _times(_turned(a), b)))


@overload(operator.add)
def _add(a, b):
    if a == _vector and b == _vector:
        return lambda a, b: _plus(a, b)
    return None


@overload(operator.sub)
def _subtract(a, b):
    if a == _vector and b == _vector:
        return lambda a, b: _minus(a, b)
    return None


@overload(operator.mul)
def _scale(a, b):
    if isinstance(a, types.Float) and b == _vector:
        return lambda a, b: _times(_all(a), b)
    if a == _vector and b == _vector:
        return lambda a, b: _times(a, b)
    return None


@overload(operator.neg)
def _negate(a):
    if a == _vector:
        return lambda a: _times(_all(-1.0), a)
    return None
