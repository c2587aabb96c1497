# mypy: allow-untyped-defs, allow-incomplete-defs
"""EIGHT double precision numbers as one register, a number of each of eight contacts, for compiled code.

`gather` and `coordinates` bring vectors (vec3.py) of eight contacts into three such registers, one for each
coordinate, `add_shares` and `scatter` bring them back; a + b, a - b, a * b, `over`, `root`, `least`, `most`,
`where_above` compute contact by contact. Products and sums may be contracted, but for those of `dots`, which
rounds as `dot` of vectors does. Arrays have four columns but where another shape is told; neither that nor places
are checked, only what numbers they are of.
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
    everywhere,
    everywhere_of,
    load_of,
    operation,
    store_of,
    where_above_of,
)

__all__ = [
    "EIGHT", "add_shares", "all_eight", "any_above", "blocks", "coordinates", "dots", "gather", "least",
    "load_eight", "most", "over", "root", "scatter", "store_eight", "where_above",
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
    """(n, k, EIGHT) doubles, each register within one line of the cache; what they are is not set."""
    flat = np.empty((n * k + 1) * EIGHT)
    first = -(flat.ctypes.data // 8) % EIGHT
    return flat[first : first + n * k * EIGHT].reshape((n, k, EIGHT))


def _mixed(builder: Any, a: Any, b: Any, places: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(places)), places))


_EVEN, _ODD = [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """Three coordinates of eight rows."""
    a, b, c, d = (_mixed(builder, rows[i], rows[i + 2], list(range(8))) for i in (0, 1, 4, 5))
    first, second = _mixed(builder, a, b, _EVEN), _mixed(builder, c, d, _EVEN)
    x, z = (_mixed(builder, first, second, [k + o for k in (0, 1, 4, 5, 8, 9, 12, 13)]) for o in (0, 2))
    first, second = _mixed(builder, a, b, _ODD), _mixed(builder, c, d, _ODD)
    return [x, _mixed(builder, first, second, [0, 1, 4, 5, 8, 9, 12, 13]), z]


def _rows(builder: Any, x: Any, y: Any, z: Any) -> list[Any]:
    """Eight rows of three coordinates, and 0."""
    nothing, rows = ir.Constant(_REGISTER, [0.0] * EIGHT), [None] * EIGHT
    for k, places in enumerate((_EVEN, _ODD)):
        xy, z0 = _mixed(builder, x, y, places), _mixed(builder, z, nothing, places)
        for m in range(4):
            rows[2 * m + k] = _mixed(builder, xy, z0, [2 * m, 2 * m + 1, 2 * m + 8, 2 * m + 9])
    return rows


def _check(array: Any, dimensions: int, number: Any) -> None:
    """That its rows are what they are taken for, but for their length, which no type tells."""
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
    """The eight numbers in row `group` of an array (k, EIGHT) of them."""
    data = context.make_array(kind)(context, builder, order).data
    first = builder.mul(group, ir.Constant(group.type, EIGHT))
    places = (builder.add(first, ir.Constant(group.type, k)) for k in range(EIGHT))
    return [builder.zext(builder.load(builder.gep(data, [place])), group.type) for place in places]


def _each(builder: Any, data: Any, at: Any) -> Any:
    """The number at a place, four times."""
    return everywhere(builder, _ROW, builder.load(builder.gep(data, [at])))


def _four(
    context: Any, builder: Any, kinds: Any, x: Any, members: Any, share: Any, group: Any
) -> Callable[[int], list[Any]]:
    """A function of a contact's number in a group: pointers to the rows of x of its four `members` and, as a
    register each, its `share` of them."""
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
    """Sums of rows of x, as coordinates: of the four `members` (m, 4) of each contact of a group, by their `share`
    (m, 4). Both have EIGHT rows a group."""

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
            # the fence: else pairs of rows are joined before they are summed up, by many more shuffles
            rows.append(_called(builder, "arithmetic.fence", total))
        return context.make_tuple(builder, signature.return_type, _columns(builder, rows))

    return types.UniTuple(_eight, 3)(x, members, share, types.intp), generate


@operation
def add_shares(typingctx, x, members, share, group, ax, ay, az):
    """Add to the rows of x of all members, which differ, their share of the vector of their contact."""

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
    """Rows order[group] of a, as coordinates."""

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
    """Coordinates as rows order[group] of a."""

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


# a[i, j] of an array (m, k, EIGHT)
load_eight, store_eight = load_of(_eight, _REGISTER, _check_block), store_of(_eight, _REGISTER, _check_block)
all_eight = everywhere_of(_eight, _REGISTER, types.float64)
_plus, _minus, _times = (elementwise(_eight, name, _FLAGS) for name in ("fadd", "fsub", "fmul"))
over = elementwise(_eight, "fdiv", ())


@operation
def dots(typingctx, ax, ay, az, bx, by, bz):
    """a . b, without contraction."""

    def generate(context, builder, signature, arguments):
        products = [builder.fmul(arguments[k], arguments[3 + k]) for k in range(3)]
        x, y, z = (_called(builder, "arithmetic.fence", product) for product in products)
        return builder.fadd(builder.fadd(x, y), z)

    return _eight(ax, ay, az, bx, by, bz), generate


@operation
def root(typingctx, a):
    """Square root."""

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


least, most = _chosen("<"), _chosen(">")
where_above = where_above_of(_eight)


@operation
def any_above(typingctx, a, b):
    """Whether a > b anywhere."""

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
