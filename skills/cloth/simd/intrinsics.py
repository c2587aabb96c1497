"""Makes compiled operations on registers; the SIMD types of this folder use them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = [
    "elementwise",
    "load_of",
    "operation",
    "place_of",
    "splat",
    "splat_of",
    "store_of",
    "where_above_of",
]  # fmt: skip


def operation(definition: Callable[..., Any]) -> Any:
    """Turn a definition into an intrinsic. Compiled code calls it without the first argument, the typing
    context."""
    return intrinsic(definition)


def elementwise(kind: types.Type, instruction: str, flags: tuple[str, ...]) -> Any:
    """Make an operation that combines two registers of type `kind` lane by lane, with an `instruction` of
    llvmlite's builder ("fadd", ...) and its fast-math `flags`."""

    def apply(typingctx: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments, flags=flags)

        return kind(kind, kind), generate

    return operation(apply)


def where_above_of(kind: types.Type) -> Any:
    """Make an operation on four registers a, b, yes, no of type `kind`: each lane is `yes` where a > b, else
    `no`."""

    def apply(typingctx: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.select(builder.fcmp_ordered(">", *arguments[:2]), *arguments[2:])

        return kind(kind, kind, kind, kind), generate

    return operation(apply)


def splat_of(kind: types.Type, register: Any, number: types.Type) -> Any:
    """Make an operation that returns a register of type `kind` with a given number in every lane."""

    def apply(typingctx: Any, s: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return splat(builder, register, arguments[0])

        return kind(number), generate

    return operation(apply)


def load_of(kind: types.Type, register: Any, check: Callable[[Any], None]) -> Any:
    """Make an operation that reads row [i, j] of an array of three axes as a register of type `kind`."""

    def apply(typingctx: Any, array: Any, i: Any, j: Any) -> Any:
        check(array)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = _row_of(context, builder, signature.args[0], arguments, register)
            return builder.load(pointer, typ=register, align=array.dtype.bitwidth // 8)

        return kind(array, types.intp, types.intp), generate

    return operation(apply)


def store_of(kind: types.Type, register: Any, check: Callable[[Any], None]) -> Any:
    """Make an operation that stores a register of type `kind` as row [i, j] of an array of three axes."""

    def apply(typingctx: Any, array: Any, i: Any, j: Any, a: Any) -> Any:
        check(array)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = _row_of(context, builder, signature.args[0], arguments, register)
            builder.store(arguments[3], pointer, align=array.dtype.bitwidth // 8)
            return context.get_dummy_value()

        return types.void(array, types.intp, types.intp, kind), generate

    return operation(apply)


def _row_of(context: Any, builder: Any, kind: types.Array, arguments: Any, register: Any) -> Any:
    place = [*arguments[1:3], context.get_constant(types.intp, 0)]
    return place_of(context, builder, kind, arguments[0], place, register)


def splat(builder: Any, register: Any, s: Any) -> Any:
    """Return a register with s in every lane."""
    first = builder.insert_element(ir.Constant(register, ir.Undefined), s, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), register.count), [0] * register.count)
    return builder.shuffle_vector(first, ir.Constant(register, ir.Undefined), zeros)


def place_of(
    context: Any, builder: Any, kind: types.Array, array: Any, place: Sequence[Any], register: Any
) -> Any:
    """Return a pointer to the `register` that begins at index `place` of an array. Negative indices are not
    supported, and nothing checks the indices."""
    found = context.make_array(kind)(context, builder, array)
    pointer = cgutils.get_item_pointer(context, builder, kind, found, list(place), wraparound=False)
    return builder.bitcast(pointer, ir.PointerType(register))
