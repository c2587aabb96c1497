# mypy: allow-untyped-defs, allow-incomplete-defs
"""SIMD type of FOUR double precision numbers in one register, one per edge or vertex, for compiled code.

`load_f64x4` reads consecutive numbers, `gather_f64x4` reads numbers at four indices, `splat_f64x4(s)` returns a
register with s in every lane, and `dots` computes the scalar products of four pairs of vectors (vec3.py). `spread`
(vec3.py) makes four registers of one: register k has number k of the given register in every lane, so that it can
be multiplied with a vector. a + b, a - b, a * b, s * a (s a float), -a, `vdiv` and `where_above` work lane by
lane. `ends` reads the vertices of four edges. The compiler may contract products and sums (fused multiply-add),
except in `dots`, which rounds as `dot` of vectors does (test_f64x4.py). Indices are not checked.

For the compiler, these registers have the same type as a vector, but their fourth number is not zero: never store
one in an array of vectors.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError

from skills.cloth.simd.intrinsics import elementwise, operation, place_of, splat_of, where_above_of
from skills.cloth.simd.vec3 import WIDTH, vector_type

__all__ = ["FOUR", "dots", "ends", "gather_f64x4", "load_f64x4", "splat_f64x4", "vdiv", "where_above"]

FOUR = WIDTH  # the same register type as a vector, so the operators of vectors apply
_INDEX = ir.IntType(32)
_REGISTER = ir.VectorType(ir.DoubleType(), FOUR)
_PLACES = types.UniTuple(types.uint32, FOUR)


@operation
def ends(typingctx, array, i):
    """Return two tuples: the first and the second numbers of rows i to i + FOUR - 1 of an array (n, 2) of unsigned
    32-bit integers."""
    fits = isinstance(array, types.Array) and array.ndim == 2 and array.dtype == types.uint32
    if not fits or array.layout != "C":
        raise TypingError(f"ends are rows of a C-ordered array (n, 2) of unsigned integers, not of {array}")

    def generate(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        first = builder.mul(arguments[1], context.get_constant(types.intp, 2))
        places = (builder.add(first, context.get_constant(types.intp, k)) for k in range(2 * FOUR))
        read = [builder.load(builder.gep(data, [place])) for place in places]
        sides = [context.make_tuple(builder, _PLACES, read[side::2]) for side in range(2)]
        return context.make_tuple(builder, signature.return_type, sides)

    return types.UniTuple(_PLACES, 2)(array, types.intp), generate


splat_f64x4 = splat_of(vector_type, _REGISTER, types.float64)
vdiv = elementwise(vector_type, "fdiv", ())
where_above = where_above_of(vector_type)


def _check_flat(array: Any) -> None:
    fits = isinstance(array, types.Array) and array.ndim == 1 and array.dtype == types.float64
    if not fits or array.layout != "C":
        raise TypingError(f"such numbers come from a flat array of doubles, not from {array}")


@operation
def load_f64x4(typingctx, array, i):
    """Read the FOUR numbers that begin at index i of a flat array."""
    _check_flat(array)

    def generate(context, builder, signature, arguments):
        place = place_of(context, builder, signature.args[0], arguments[0], arguments[1:], _REGISTER)
        return builder.load(place, typ=_REGISTER, align=8)

    return vector_type(array, types.intp), generate


@operation
def gather_f64x4(typingctx, array, places):
    """Read the numbers at the FOUR indices `places` of a flat array."""
    _check_flat(array)

    def generate(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        made = ir.Constant(_REGISTER, ir.Undefined)
        for k, place in enumerate(cgutils.unpack_tuple(builder, arguments[1])):
            number = builder.load(builder.gep(data, [builder.zext(place, ir.IntType(64))]))
            made = builder.insert_element(made, number, ir.Constant(_INDEX, k))
        return made

    return vector_type(array, _PLACES), generate


@operation
def dots(typingctx, a, b):
    """Return the scalar products of FOUR pairs of vectors, without contraction."""

    def generate(context, builder, signature, arguments):
        a, b = (cgutils.unpack_tuple(builder, four) for four in arguments)
        kind = ir.FunctionType(_REGISTER, [_REGISTER])
        fence = cgutils.get_or_insert_function(builder.module, kind, f"llvm.arithmetic.fence.v{FOUR}f64")
        products = [builder.call(fence, [builder.fmul(a[k], b[k])]) for k in range(FOUR)]

        def mixed(pair: list[Any], order: list[int]) -> Any:
            return builder.shuffle_vector(*pair, ir.Constant(ir.VectorType(_INDEX, FOUR), order))

        xz, yw = ([mixed(products[k : k + 2], [o, 4 + o, 2 + o, 6 + o]) for k in (0, 2)] for o in range(2))
        x, z, y = mixed(xz, [0, 1, 4, 5]), mixed(xz, [2, 3, 6, 7]), mixed(yw, [0, 1, 4, 5])
        return builder.fadd(builder.fadd(x, y), z)

    four = types.UniTuple(vector_type, FOUR)
    return vector_type(four, four), generate
