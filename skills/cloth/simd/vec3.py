# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of a point or direction, one register of four doubles, for compiled code.

Arrays of vectors have four columns; the fourth column is always zero. `load` reads a row
and `store` writes it; `store_singles` stores a vector in single precision. `vector(x, y, z)` makes a vector. a +
b, a - b, -a, s * a (s a float), `dot` and `cross` compute with vectors. A row of four weights is not a vector but
can be loaded like one: `spread` then returns four registers, each with one weight in every lane, and a * b
multiplies such a register with a vector. `members` reads the four vertices that the weights belong to. The
compiler may contract products and sums (fused multiply-add), as everywhere in the solver. Nothing checks the
number of columns: an array with fewer than four would be read and written beyond its rows.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.extending import overload

from foldcell.skills.cloth.inner import inner
from foldcell.skills.cloth.simd.registers import INDEX, ArrayOf, Register, elementwise, mixed, operation, splat_of

WIDTH = 4
vector_type = Register(types.float64, WIDTH, ("contract",))
VECTORS, MEMBERS = ArrayOf(2, (types.float64,)), ArrayOf(2, (types.uint32,))
PLACES = types.UniTuple(types.uint32, WIDTH)


@operation(vector_type, VECTORS, types.intp)
def load(builder, array, i):
    """Read row i of an array (n, WIDTH)."""
    return array.load(array.row(i, vector_type.llvm))


@operation(types.void, VECTORS, types.intp, vector_type)
def store(builder, array, i, v):
    """Write v to row i of an array (n, WIDTH)."""
    array.store(v, array.row(i, vector_type.llvm))


@operation(PLACES, MEMBERS, types.intp)
def members(builder, array, i):
    """Read the four numbers in row i of an array (n, 4) of unsigned 32-bit integers."""
    first = builder.mul(i, ir.Constant(i.type, WIDTH))
    return [array.load(array.row(builder.add(first, ir.Constant(i.type, k)), INDEX)) for k in range(WIDTH)]


@operation(types.void, ArrayOf(1, (types.float32,)), types.intp, types.intp, vector_type)
def store_singles(builder, array, at, step, v):
    """Store the three coordinates of v as singles at indices at, at + step and at + 2 step of a flat array."""
    single = ir.FloatType()
    singles = builder.fptrunc(v, ir.VectorType(single, WIDTH))
    for k in range(3):
        array.store(builder.extract_element(singles, ir.Constant(INDEX, k)), array.at((at,), single))
        at = builder.add(at, step)


@operation(vector_type, types.float64, types.float64, types.float64)
def vector(builder, x, y, z):
    """Make a vector of three floats."""
    made = ir.Constant(vector_type.llvm, [0.0] * WIDTH)
    for k, value in enumerate((x, y, z)):
        made = builder.insert_element(made, value, ir.Constant(INDEX, k))
    return made


@operation(types.UniTuple(vector_type, WIDTH), vector_type)
def spread(builder, v):
    """Return four registers: register k has number k of v in all lanes."""
    return [mixed(builder, v, ir.Constant(v.type, ir.Undefined), [k] * WIDTH) for k in range(WIDTH)]


@operation(vector_type, vector_type)
def _turned(builder, v):
    """Return (y, z, x) of v = (x, y, z)."""
    return mixed(builder, v, ir.Constant(v.type, ir.Undefined), [1, 2, 0, 3])


@operation(types.float64, vector_type, vector_type)
def dot(builder, a, b):
    """Return a . b."""
    flags = vector_type.flags
    products = builder.fmul(a, b, flags=flags)
    x, y, z = (builder.extract_element(products, ir.Constant(INDEX, k)) for k in range(3))
    return builder.fadd(builder.fadd(x, y, flags=flags), z, flags=flags)


_all, _times = splat_of(vector_type), elementwise(vector_type, "fmul")


@inner()
def cross(a, b):
    """Return a x b."""
    return _turned(a * _turned(b) - _turned(a) * b)


@overload(operator.mul)
def _scale(a, b):
    if isinstance(a, types.Float) and b == vector_type:
        return lambda a, b: _times(_all(a), b)
    return None


@overload(operator.neg)
def _negate(a):
    if a == vector_type:
        return lambda a: _times(_all(-1.0), a)
    return None
