# mypy: allow-untyped-defs, allow-incomplete-defs
"""Makes the SIMD types of this folder: numba types of registers, and compiled operations on them.

A register contains numbers of one type, one in each lane. a + b, a - b, a * b and a / b work lane by lane on
registers of floating-point numbers. The compiler may contract products and sums (fused multiply-add).
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic, models, overload, register_model

INDEX = ir.IntType(32)
_NUMBERS = {types.float64: ir.DoubleType(), types.float32: ir.FloatType(), types.int32: ir.IntType(32)}


class Register(types.Type):
    """Type of registers with `lanes` numbers of type `number`. flags: fast-math flags of their operations; empty
    for integers. llvm: the compiler's type."""

    def __init__(self, number: types.Number, lanes: int, flags: tuple[str, ...] = ()) -> None:
        super().__init__(name=f"{number}x{lanes}")
        self.number, self.lanes, self.flags = number, lanes, flags
        self.llvm = ir.VectorType(_NUMBERS[number], lanes)


@register_model(Register)
class _RegisterModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Register) -> None:
        super().__init__(manager, kind, kind.llvm)  # type: ignore[no-untyped-call]


@dataclass(frozen=True)
class ArrayOf:
    """An array argument: C-ordered, with `axes` axes of one of the types `numbers`. The lengths of the axes are no
    part of a numba type, so they are not checked."""

    axes: int
    numbers: tuple[types.Number, ...]

    def accept(self, given: Any) -> Any:
        """Return the numba type of an array. Raises TypingError if it does not fit."""
        fits = isinstance(given, types.Array) and given.ndim == self.axes and given.dtype in self.numbers
        if not fits or given.layout != "C":
            numbers = " or ".join(map(str, self.numbers))
            raise TypingError(f"expected a C-ordered array of {self.axes} axes of {numbers}, not {given}")
        return given


class Elements:
    """An array argument as the operation sees it. Nothing checks the indices; negative ones are not supported."""

    def __init__(self, context: Any, builder: Any, kind: Any, array: Any) -> None:
        self._context, self._builder, self._kind = context, builder, kind
        self._array = context.make_array(kind)(context, builder, array)
        self._align = kind.dtype.bitwidth // 8

    def row(self, i: Any, kind: Any) -> Any:
        """Return a pointer to element i of the memory as an array of the compiler's type `kind`. Unlike `at`, it
        does not read the shape."""
        data = self._builder.bitcast(self._array.data, ir.PointerType(kind))
        return self._builder.gep(data, [i if isinstance(i, ir.Value) else ir.Constant(ir.IntType(64), i)])

    def at(self, place: tuple[Any, ...], kind: Any) -> Any:
        """Return a pointer to the value of the compiler's type `kind` that begins at the index `place`."""
        place = tuple(i if isinstance(i, ir.Value) else ir.Constant(ir.IntType(64), i) for i in place)
        found = cgutils.get_item_pointer(
            self._context, self._builder, self._kind, self._array, list(place), wraparound=False
        )
        return self._builder.bitcast(found, ir.PointerType(kind))

    def load(self, pointer: Any) -> Any:
        """Read the value at a pointer, which need not be aligned better than the numbers of the array."""
        return self._builder.load(pointer, typ=pointer.type.pointee, align=self._align)

    def store(self, value: Any, pointer: Any) -> None:
        """Write the value to a pointer, as `load` reads it."""
        self._builder.store(value, pointer, align=self._align)


def operation(result: types.Type, *operands: types.Type | ArrayOf) -> Callable[[Callable[..., Any]], Any]:
    """Turn a function that emits instructions into an operation that compiled code can call.

    The function's arguments are llvmlite's builder, and one for each of the `operands`: a value, a list for a
    tuple, `Elements` for an array. It returns a value of type `result`, for a tuple a list of values.
    """

    def decorate(emit: Callable[..., Any]) -> Any:
        @wraps(emit)  # numba reads the names of the arguments
        def define(typingctx: Any, *given: Any) -> Any:
            kinds = [o.accept(g) if isinstance(o, ArrayOf) else o for o, g in zip(operands, given, strict=True)]

            def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                seen = [_seen(context, builder, *pair) for pair in zip(signature.args, arguments, strict=True)]
                return _packed(context, builder, result, emit(builder, *seen))

            return result(*kinds), generate

        return intrinsic(define)

    return decorate


def _seen(context: Any, builder: Any, kind: types.Type, argument: Any) -> Any:
    if isinstance(kind, types.Array):
        return Elements(context, builder, kind, argument)
    return cgutils.unpack_tuple(builder, argument) if isinstance(kind, types.BaseTuple) else argument


def _packed(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.UniTuple):
        parts = [_packed(context, builder, kind.dtype, part) for part in value]
        return context.make_tuple(builder, kind, parts)
    return context.get_dummy_value() if kind == types.void else value


def call(builder: Any, name: str, a: Any, *more: Any) -> Any:
    """Call LLVM's intrinsic function `name` on a register, with any `more` arguments. It returns a register of the
    same type."""
    number = {"double": "f64", "float": "f32", "i32": "i32"}[str(a.type.element)]
    kind = ir.FunctionType(a.type, [a.type, *(b.type for b in more)])
    name = f"llvm.{name}.v{a.type.count}{number}"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [a, *more])


def mixed(builder: Any, a: Any, b: Any, places: list[int]) -> Any:
    """Return a register with lanes of a and b. `places` are their indices in the concatenation of a and b."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INDEX, len(places)), places))


def splat(builder: Any, register: Any, s: Any) -> Any:
    """Return a register of the compiler's type `register` with s in every lane."""
    nothing = ir.Constant(register, ir.Undefined)
    return mixed(builder, builder.insert_element(nothing, s, ir.Constant(INDEX, 0)), nothing, [0] * register.count)


def _compared(builder: Any, kind: Register, sign: str, a: Any, b: Any) -> Any:
    if kind.flags:
        return builder.fcmp_ordered(sign, a, b, flags=kind.flags)
    return builder.icmp_signed(sign, a, b)


def elementwise(kind: Register, instruction: str) -> Any:
    """Make an operation that combines two registers lane by lane with an `instruction` of llvmlite's builder."""

    @operation(kind, kind, kind)
    def combine(builder: Any, a: Any, b: Any) -> Any:
        return getattr(builder, instruction)(a, b, flags=kind.flags)

    return combine


def choose(kind: Register, sign: str) -> Any:
    """Make an operation that takes each lane from a if a `sign` b holds there, else from b."""

    @operation(kind, kind, kind)
    def chosen(builder: Any, a: Any, b: Any) -> Any:
        return builder.select(_compared(builder, kind, sign, a, b), a, b)

    return chosen


def mask_where(kind: Register, sign: str) -> Any:
    """Make an operation that returns an integer whose bit k is set if a `sign` b holds in lane k."""

    @operation(types.int32, kind, kind)
    def mask(builder: Any, a: Any, b: Any) -> Any:
        met = builder.bitcast(_compared(builder, kind, sign, a, b), ir.IntType(kind.lanes))
        return builder.zext(met, ir.IntType(32))

    return mask


def where_above_of(kind: Register) -> Any:
    """Make an operation that takes each lane from `yes` if a > b holds there, else from `no`."""

    @operation(kind, kind, kind, kind, kind)
    def where_above(builder: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
        return builder.select(_compared(builder, kind, ">", a, b), yes, no)

    return where_above


def splat_of(kind: Register) -> Any:
    """Make an operation that returns a register with the number s in every lane."""
    return operation(kind, kind.number)(lambda builder, s: splat(builder, kind.llvm, s))


def load_rows(kind: Register, *numbers: types.Number) -> Any:
    """Make an operation that reads a[i, j] of an array (m, k, lanes) of one of the types `numbers`."""

    @operation(kind, ArrayOf(3, numbers), types.intp, types.intp)
    def load(builder: Any, a: Any, i: Any, j: Any) -> Any:
        return a.load(a.at((i, j, 0), kind.llvm))

    return load


def store_rows(kind: Register, *numbers: types.Number) -> Any:
    """Make an operation that writes a register to a[i, j] of an array (m, k, lanes)."""

    @operation(types.void, ArrayOf(3, numbers), types.intp, types.intp, kind)
    def store(builder: Any, a: Any, i: Any, j: Any, register: Any) -> Any:
        a.store(register, a.at((i, j, 0), kind.llvm))

    return store


def _give(sign: Callable[[Any, Any], Any], instruction: str) -> None:
    @overload(sign)
    def apply(a, b):
        if isinstance(a, Register) and a == b and a.flags:
            function = elementwise(a, instruction)
            return lambda a, b: function(a, b)
        return None


for _sign, _instruction in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")
):  # fmt: skip
    _give(_sign, _instruction)
