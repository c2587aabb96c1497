"""What the modules that compute in registers share: how compiled code is given operations of its own, and how it
finds what an array has at a place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["elementwise", "everywhere", "operation", "place_of", "where_above_of"]


def operation(definition: Callable[..., Any]) -> Any:
    """An intrinsic: compiled code calls it without the typing context."""
    return intrinsic(definition)


def elementwise(kind: types.Type, instruction: str, flags: tuple[str, ...]) -> Any:
    """An operation on two registers of a `kind`, place by place: an `instruction` of llvmlite's builder
    ("fadd", ...) with its fast-math `flags`."""

    def apply(typingctx: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments, flags=flags)

        return kind(kind, kind), generate

    return operation(apply)


def where_above_of(kind: types.Type) -> Any:
    """An operation on four registers of a `kind`: of the last two the first one where a > b, else the other."""

    def apply(typingctx: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.select(builder.fcmp_ordered(">", *arguments[:2]), *arguments[2:])

        return kind(kind, kind, kind, kind), generate

    return operation(apply)


def everywhere(builder: Any, register: Any, s: Any) -> Any:
    """A register with s in every place."""
    first = builder.insert_element(ir.Constant(register, ir.Undefined), s, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), register.count), [0] * register.count)
    return builder.shuffle_vector(first, ir.Constant(register, ir.Undefined), zeros)


def place_of(
    context: Any, builder: Any, kind: types.Array, array: Any, place: Sequence[Any], register: Any
) -> Any:
    """Pointer to the `register` that begins at a place of an array. Places are not wrapped round: they must not be
    negative, and nothing checks them."""
    found = context.make_array(kind)(context, builder, array)
    pointer = cgutils.get_item_pointer(context, builder, kind, found, list(place), wraparound=False)
    return builder.bitcast(pointer, ir.PointerType(register))
