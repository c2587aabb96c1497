# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of FOUR double precision numbers in one register, one per edge or vertex, for compiled code.

`load_f64x4` reads consecutive numbers, `gather_f64x4` reads numbers at four indices, `splat_f64x4(s)` returns a
register with s in every lane, and `dots` computes the scalar products of four pairs of vectors (vec3.py). `spread`
(vec3.py) makes four registers of one: register k has number k of the given register in every lane, so that it can
be multiplied with a vector. a + b, a - b, a * b, a / b, s * a (s a float), -a and `where_above` work lane by lane.
`ends` reads the vertices of four edges. The compiler may contract products and sums (fused multiply-add), except
in `dots`, which rounds as `dot` of vectors does (test_f64x4.py). Indices are not checked.

For the compiler, these registers have the same type as a vector, but their fourth number is not zero: never store
one in an array of vectors.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types

from foldcell.skills.cloth.simd.registers import INDEX, ArrayOf, call, mixed, operation, splat_of, where_above_of
from foldcell.skills.cloth.simd.vec3 import MEMBERS, PLACES, WIDTH, vector_type

FOUR = WIDTH  # the same register type as a vector, so the operators of vectors apply
NUMBERS, VECTORS = ArrayOf(1, (types.float64,)), types.UniTuple(vector_type, FOUR)

splat_f64x4, where_above = splat_of(vector_type), where_above_of(vector_type)


@operation(types.UniTuple(PLACES, 2), MEMBERS, types.intp)
def ends(builder, array, i):
    """Return two tuples: the first and the second numbers of rows i to i + FOUR - 1 of an array (n, 2) of unsigned
    32-bit integers."""
    first = builder.mul(i, ir.Constant(i.type, 2))
    places = [builder.add(first, ir.Constant(i.type, k)) for k in range(2 * FOUR)]
    read = [array.load(array.row(place, INDEX)) for place in places]
    return read[0::2], read[1::2]


@operation(vector_type, NUMBERS, types.intp)
def load_f64x4(builder, array, i):
    """Read the FOUR numbers that begin at index i of a flat array."""
    return array.load(array.at((i,), vector_type.llvm))


@operation(vector_type, NUMBERS, PLACES)
def gather_f64x4(builder, array, places):
    """Read the numbers at the FOUR indices `places` of a flat array."""
    made = ir.Constant(vector_type.llvm, ir.Undefined)
    for k, place in enumerate(places):
        number = array.load(array.row(builder.zext(place, ir.IntType(64)), ir.DoubleType()))
        made = builder.insert_element(made, number, ir.Constant(INDEX, k))
    return made


@operation(vector_type, VECTORS, VECTORS)
def dots(builder, a, b):
    """Return the scalar products of FOUR pairs of vectors, without contraction."""
    p, q, r, s = (call(builder, "arithmetic.fence", builder.fmul(*pair)) for pair in zip(a, b, strict=True))
    xz, zx = (mixed(builder, a, b, [0, 4, 2, 6]) for a, b in ((p, q), (r, s)))
    yw, wy = (mixed(builder, a, b, [1, 5, 3, 7]) for a, b in ((p, q), (r, s)))
    x, z = mixed(builder, xz, zx, [0, 1, 4, 5]), mixed(builder, xz, zx, [2, 3, 6, 7])
    y = mixed(builder, yw, wy, [0, 1, 4, 5])
    return builder.fadd(builder.fadd(x, y), z)
