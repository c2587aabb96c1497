# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of EIGHT double precision numbers in one register, one per contact, for compiled code.

`gather` and `coordinates` read one vector (vec3.py) for each of eight contacts into three such registers, which
contain the x, y and z coordinates. `add_shares` and `scatter` write them back. a + b, a - b, a * b, a / b,
`vsqrt`, `vmin`, `vmax` and `where_above` work contact by contact. The compiler may contract products and sums
(fused multiply-add), except in `dots`, which rounds as `dot` of vectors does. Arrays have four columns unless a
function states another shape. Types are checked; shapes and indices are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types

from foldcell.skills.cloth.simd.registers import (
    INDEX,
    Elements,
    Register,
    call,
    choose,
    load_rows,
    mixed,
    operation,
    splat,
    splat_of,
    store_rows,
    where_above_of,
)
from foldcell.skills.cloth.simd.vec3 import MEMBERS, VECTORS, WIDTH, vector_type

EIGHT = 8
_ROW, _FLAGS = vector_type.llvm, ("contract",)
_eight = Register(types.float64, EIGHT, _FLAGS)
_three = types.UniTuple(_eight, 3)


@njit(nogil=True)
def blocks(n, k):
    """Return an uninitialised array (n, k, EIGHT) of doubles. Each register [i, j] fills one cache line."""
    flat = np.empty((n * k + 1) * EIGHT)
    first = -(flat.ctypes.data // 8) % EIGHT
    return flat[first : first + n * k * EIGHT].reshape((n, k, EIGHT))


_EVEN, _ODD = [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """Convert eight rows (x, y, z, 0) to three registers: all x, all y and all z."""
    a, b, c, d = (mixed(builder, rows[i], rows[i + 2], list(range(8))) for i in (0, 1, 4, 5))
    first, second = mixed(builder, a, b, _EVEN), mixed(builder, c, d, _EVEN)
    x, z = (mixed(builder, first, second, [k + o for k in (0, 1, 4, 5, 8, 9, 12, 13)]) for o in (0, 2))
    first, second = mixed(builder, a, b, _ODD), mixed(builder, c, d, _ODD)
    return [x, mixed(builder, first, second, [0, 1, 4, 5, 8, 9, 12, 13]), z]


def _rows(builder: Any, x: Any, y: Any, z: Any) -> list[Any]:
    """Convert three registers, all x, all y and all z, to eight rows (x, y, z, 0)."""
    nothing, rows = ir.Constant(_eight.llvm, [0.0] * EIGHT), [None] * EIGHT
    for k, places in enumerate((_EVEN, _ODD)):
        xy, z0 = mixed(builder, x, y, places), mixed(builder, z, nothing, places)
        for m in range(4):
            rows[2 * m + k] = mixed(builder, xy, z0, [2 * m, 2 * m + 1, 2 * m + 8, 2 * m + 9])
    return rows


def _who(builder: Any, order: Elements, group: Any) -> list[Any]:
    """Read the eight indices in row `group` of an array (k, EIGHT)."""
    first = builder.mul(group, ir.Constant(group.type, EIGHT))
    places = (builder.add(first, ir.Constant(group.type, k)) for k in range(EIGHT))
    return [builder.zext(order.load(order.row(place, INDEX)), group.type) for place in places]


def _four(
    builder: Any, x: Elements, members: Elements, share: Elements, group: Any
) -> Iterator[list[tuple[Any, Any]]]:
    """For each contact of a group, yield four pairs, one per member of the contact: a pointer to the member's row
    of x, and a register with the member's share in every lane."""
    first = builder.mul(group, ir.Constant(group.type, EIGHT * WIDTH))
    member, own = members.row(first, INDEX), share.row(first, ir.DoubleType())
    for c in range(EIGHT):
        found = []
        for k in range(WIDTH):
            at = [ir.Constant(group.type, WIDTH * c + k)]
            row = builder.zext(members.load(builder.gep(member, at)), group.type)
            found.append((x.row(row, _ROW), splat(builder, _ROW, share.load(builder.gep(own, at)))))
        yield found


@operation(_three, VECTORS, MEMBERS, VECTORS, types.intp)
def gather(builder, x, members, share, group):
    """Compute a weighted sum for each contact of a group: the rows of x of the contact's four `members` (m, 4),
    with the weights `share` (m, 4). Returns the sums as three registers of coordinates. Both arrays have EIGHT
    rows per group, one per contact."""
    rows = []
    for (place, weight), *others in _four(builder, x, members, share, group):
        total = builder.fmul(weight, x.load(place), flags=_FLAGS)
        for place, weight in others:
            total = builder.fadd(total, builder.fmul(weight, x.load(place), flags=_FLAGS), flags=_FLAGS)
        # without the fence the compiler joins pairs of rows before the sum, with many more shuffles
        rows.append(call(builder, "arithmetic.fence", total))
    return _columns(builder, rows)


@operation(types.void, VECTORS, MEMBERS, VECTORS, types.intp, _eight, _eight, _eight)
def add_shares(builder, x, members, share, group, ax, ay, az):
    """Add the vector (ax, ay, az) of each contact of a group, multiplied by the share of each member of the
    contact, to the member's row of x. No row of x may occur twice among the members of the group."""
    vectors = _rows(builder, ax, ay, az)
    for vector, four in zip(vectors, _four(builder, x, members, share, group), strict=True):
        for place, weight in four:
            more = builder.fmul(weight, vector, flags=_FLAGS)
            x.store(builder.fadd(x.load(place), more, flags=_FLAGS), place)


@operation(_three, VECTORS, MEMBERS, types.intp)
def coordinates(builder, a, order, group):
    """Read the EIGHT rows order[group] of a, (n, 4), into three registers of coordinates."""
    return _columns(builder, [a.load(a.row(c, _ROW)) for c in _who(builder, order, group)])


@operation(types.void, VECTORS, MEMBERS, types.intp, _eight, _eight, _eight)
def scatter(builder, a, order, group, x, y, z):
    """Write three registers of coordinates to the EIGHT rows order[group] of a, (n, 4)."""
    for c, row in zip(_who(builder, order, group), _rows(builder, x, y, z), strict=True):
        a.store(row, a.row(c, _ROW))


# read and write a[i, j] of an array (m, k, EIGHT)
load_f64x8, store_f64x8 = load_rows(_eight, types.float64), store_rows(_eight, types.float64)
splat_f64x8, where_above = splat_of(_eight), where_above_of(_eight)
vmin, vmax = choose(_eight, "<"), choose(_eight, ">")


@operation(_eight, *[_eight] * 6)
def dots(builder, ax, ay, az, bx, by, bz):
    """Return the scalar products a . b, without contraction."""
    pairs = (ax, bx), (ay, by), (az, bz)
    x, y, z = (call(builder, "arithmetic.fence", builder.fmul(a, b)) for a, b in pairs)
    return builder.fadd(builder.fadd(x, y), z)


@operation(_eight, _eight)
def vsqrt(builder, a):
    """Return the square root of each lane."""
    return call(builder, "sqrt", a)


@operation(types.boolean, _eight, _eight)
def any_above(builder, a, b):
    """Return whether a > b in any lane."""
    met = builder.bitcast(builder.fcmp_ordered(">", a, b), ir.IntType(EIGHT))
    return builder.icmp_unsigned("!=", met, ir.Constant(ir.IntType(EIGHT), 0))
