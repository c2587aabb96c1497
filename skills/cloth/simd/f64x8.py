# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of EIGHT double precision numbers in one register, one per contact, for compiled code.

`gather` and `coordinates` read one vector (vec3.py) for each of eight contacts into three such registers, which
contain the x, y and z coordinates. `add_shares` and `scatter` write them back. a + b, a - b, a * b, `vdiv`,
`vsqrt`, `vmin`, `vmax` and `where_above` work contact by contact. The compiler may contract products and sums
(fused multiply-add), except in `dots`, which rounds as `dot` of vectors does. Arrays have four columns unless a
function states another shape. Types are checked; shapes and indices are not.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import models, overload, register_model

from skills.cloth.simd.intrinsics import (
    elementwise,
    load_of,
    operation,
    splat,
    splat_of,
    store_of,
    where_above_of,
)

__all__ = [
    "EIGHT",
    "add_shares",
    "any_above",
    "blocks",
    "coordinates",
    "dots",
    "gather",
    "load_f64x8",
    "scatter",
    "splat_f64x8",
    "store_f64x8",
    "vdiv",
    "vmax",
    "vmin",
    "vsqrt",
    "where_above",
]  # fmt: skip

EIGHT, _WIDTH = 8, 4
_DOUBLE, _INDEX = ir.DoubleType(), ir.IntType(32)
_REGISTER, _ROW = ir.VectorType(_DOUBLE, EIGHT), ir.VectorType(_DOUBLE, _WIDTH)
_FLAGS = ("contract",)


class _Eight(types.Type):
    pass


_eight = _Eight(name="Eight")


@register_model(_Eight)
class _EightModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)  # type: ignore[no-untyped-call]


def _called(builder: Any, name: str, a: Any) -> Any:
    kind = ir.FunctionType(a.type, [a.type])
    return builder.call(
        cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{a.type.count}f64"), [a]
    )


@njit(nogil=True)
def blocks(n, k):
    """Return an uninitialised array (n, k, EIGHT) of doubles. Each register [i, j] fills one cache line."""
    flat = np.empty((n * k + 1) * EIGHT)
    first = -(flat.ctypes.data // 8) % EIGHT
    return flat[first : first + n * k * EIGHT].reshape((n, k, EIGHT))


def _mixed(builder: Any, a: Any, b: Any, places: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(places)), places))


_EVEN, _ODD = [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """Convert eight rows (x, y, z, 0) to three registers: all x, all y and all z."""
    a, b, c, d = (_mixed(builder, rows[i], rows[i + 2], list(range(8))) for i in (0, 1, 4, 5))
    first, second = _mixed(builder, a, b, _EVEN), _mixed(builder, c, d, _EVEN)
    x, z = (_mixed(builder, first, second, [k + o for k in (0, 1, 4, 5, 8, 9, 12, 13)]) for o in (0, 2))
    first, second = _mixed(builder, a, b, _ODD), _mixed(builder, c, d, _ODD)
    return [x, _mixed(builder, first, second, [0, 1, 4, 5, 8, 9, 12, 13]), z]


def _rows(builder: Any, x: Any, y: Any, z: Any) -> list[Any]:
    """Convert three registers, all x, all y and all z, to eight rows (x, y, z, 0)."""
    nothing, rows = ir.Constant(_REGISTER, [0.0] * EIGHT), [None] * EIGHT
    for k, places in enumerate((_EVEN, _ODD)):
        xy, z0 = _mixed(builder, x, y, places), _mixed(builder, z, nothing, places)
        for m in range(4):
            rows[2 * m + k] = _mixed(builder, xy, z0, [2 * m, 2 * m + 1, 2 * m + 8, 2 * m + 9])
    return rows


def _check(array: Any, dimensions: int, number: Any) -> None:
    """Check an array's Numba type: number of axes, number type and C order. The row length is not part of that
    type, so it is not checked. Raises TypingError."""
    fits = isinstance(array, types.Array) and array.ndim == dimensions and array.dtype == number
    if not fits or array.layout != "C":
        raise TypingError(f"eights are of C-ordered arrays of {dimensions} axes of {number}, not of {array}")


def _data(context: Any, builder: Any, kind: Any, array: Any, register: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(data, ir.PointerType(register))


def _read(builder: Any, row: Any) -> Any:
    read = builder.load(row, typ=_ROW)
    read.align = 8
    return read


def _who(context: Any, builder: Any, kind: Any, order: Any, group: Any) -> list[Any]:
    """Read the eight indices in row `group` of an array (k, EIGHT)."""
    data = context.make_array(kind)(context, builder, order).data
    first = builder.mul(group, ir.Constant(group.type, EIGHT))
    places = (builder.add(first, ir.Constant(group.type, k)) for k in range(EIGHT))
    return [builder.zext(builder.load(builder.gep(data, [place])), group.type) for place in places]


def _each(builder: Any, data: Any, at: Any) -> Any:
    """Return a register with the number at index `at` in all four lanes."""
    return splat(builder, _ROW, builder.load(builder.gep(data, [at])))


def _four(
    context: Any, builder: Any, kinds: Any, x: Any, members: Any, share: Any, group: Any
) -> Callable[[int], list[Any]]:
    """Return a function that maps the index of a contact in its group to four pairs, one per member of the
    contact: a pointer to the member's row of x, and a register with the member's share in every lane."""
    rows, shares = _data(context, builder, kinds[0], x, _ROW), _data(context, builder, kinds[2], share, _DOUBLE)
    first = builder.mul(group, ir.Constant(group.type, EIGHT * _WIDTH))
    member = builder.gep(context.make_array(kinds[1])(context, builder, members).data, [first])
    shares = builder.gep(shares, [first])

    def of(c: int) -> list[Any]:
        found = []
        for k in range(_WIDTH):
            at = ir.Constant(group.type, _WIDTH * c + k)
            row = builder.zext(builder.load(builder.gep(member, [at])), group.type)
            found.append((builder.gep(rows, [row]), _each(builder, shares, at)))
        return found

    return of


@operation
def gather(typingctx, x, members, share, group):
    """Compute a weighted sum for each contact of a group: the rows of x of the contact's four `members` (m, 4),
    with the weights `share` (m, 4). Returns the sums as three registers of coordinates. Both arrays have EIGHT
    rows per group, one per contact."""

    for rows in (x, share):
        _check(rows, 2, types.float64)
    _check(members, 2, types.uint32)

    def generate(context, builder, signature, arguments):
        of, rows = _four(context, builder, signature.args, *arguments), []
        for c in range(EIGHT):
            total = None
            for place, weight in of(c):
                part = builder.fmul(weight, _read(builder, place), flags=_FLAGS)
                total = part if total is None else builder.fadd(total, part, flags=_FLAGS)
            # without the fence the compiler joins pairs of rows before the sum, with many more shuffles
            rows.append(_called(builder, "arithmetic.fence", total))
        return context.make_tuple(builder, signature.return_type, _columns(builder, rows))

    return types.UniTuple(_eight, 3)(x, members, share, types.intp), generate


@operation
def add_shares(typingctx, x, members, share, group, ax, ay, az):
    """Add the vector (ax, ay, az) of each contact of a group, multiplied by the share of each member of the
    contact, to the member's row of x. No row of x may occur twice among the members of the group."""

    for rows in (x, share):
        _check(rows, 2, types.float64)
    _check(members, 2, types.uint32)

    def generate(context, builder, signature, arguments):
        of = _four(context, builder, signature.args, *arguments[:4])
        for c, vector in enumerate(_rows(builder, *arguments[4:])):
            for place, weight in of(c):
                more = builder.fmul(weight, vector, flags=_FLAGS)
                builder.store(builder.fadd(_read(builder, place), more, flags=_FLAGS), place).align = 8
        return context.get_dummy_value()

    return types.void(x, members, share, types.intp, ax, ay, az), generate


@operation
def coordinates(typingctx, a, order, group):
    """Read the EIGHT rows order[group] of a, (n, 4), into three registers of coordinates."""

    _check(a, 2, types.float64)
    _check(order, 2, types.uint32)

    def generate(context, builder, signature, arguments):
        data = _data(context, builder, signature.args[0], arguments[0], _ROW)
        who = _who(context, builder, signature.args[1], *arguments[1:])
        rows = [_read(builder, builder.gep(data, [c])) for c in who]
        return context.make_tuple(builder, signature.return_type, _columns(builder, rows))

    return types.UniTuple(_eight, 3)(a, order, types.intp), generate


@operation
def scatter(typingctx, a, order, group, x, y, z):
    """Write three registers of coordinates to the EIGHT rows order[group] of a, (n, 4)."""

    _check(a, 2, types.float64)
    _check(order, 2, types.uint32)

    def generate(context, builder, signature, arguments):
        data = _data(context, builder, signature.args[0], arguments[0], _ROW)
        who = _who(context, builder, signature.args[1], *arguments[1:3])
        for c, row in zip(who, _rows(builder, *arguments[3:]), strict=True):
            builder.store(row, builder.gep(data, [c])).align = 8
        return context.get_dummy_value()

    return types.void(a, order, types.intp, x, y, z), generate


def _check_block(array: Any) -> None:
    _check(array, 3, types.float64)


# read and write a[i, j] of an array (m, k, EIGHT)
load_f64x8, store_f64x8 = load_of(_eight, _REGISTER, _check_block), store_of(_eight, _REGISTER, _check_block)
splat_f64x8 = splat_of(_eight, _REGISTER, types.float64)
_plus, _minus, _times = (elementwise(_eight, name, _FLAGS) for name in ("fadd", "fsub", "fmul"))
vdiv = elementwise(_eight, "fdiv", ())


@operation
def dots(typingctx, ax, ay, az, bx, by, bz):
    """Return the scalar products a . b, without contraction."""

    def generate(context, builder, signature, arguments):
        products = [builder.fmul(arguments[k], arguments[3 + k]) for k in range(3)]
        x, y, z = (_called(builder, "arithmetic.fence", product) for product in products)
        return builder.fadd(builder.fadd(x, y), z)

    return _eight(ax, ay, az, bx, by, bz), generate


@operation
def vsqrt(typingctx, a):
    """Return the square root of each lane."""

    def generate(context, builder, signature, arguments):
        return _called(builder, "sqrt", arguments[0])

    return _eight(_eight), generate


def _chosen(sign: str) -> Any:
    @operation
    def apply(typingctx, a, b):
        def generate(context, builder, signature, arguments):
            return builder.select(builder.fcmp_ordered(sign, *arguments), *arguments)

        return _eight(_eight, _eight), generate

    return apply


vmin, vmax = _chosen("<"), _chosen(">")
where_above = where_above_of(_eight)


@operation
def any_above(typingctx, a, b):
    """Return whether a > b in any lane."""

    def generate(context, builder, signature, arguments):
        met = builder.bitcast(builder.fcmp_ordered(">", *arguments), ir.IntType(EIGHT))
        return builder.icmp_unsigned("!=", met, ir.Constant(ir.IntType(EIGHT), 0))

    return types.boolean(a, b), generate


def _give(sign: Any, function: Any) -> None:
    @overload(sign)
    def apply(a, b):
        if a == _eight and b == _eight:
            return lambda a, b: function(a, b)
        return None


for _sign, _function in ((operator.add, _plus), (operator.sub, _minus), (operator.mul, _times)):
    _give(_sign, _function)
