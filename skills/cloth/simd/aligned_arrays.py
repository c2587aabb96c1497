"""Allocates arrays that begin at a cache line, single ones and whole tables of them.

A SIMD register is as long as a cache line (64 bytes) or half as long. In an array that does not begin at a cache
line, every register or every second register spans two lines, and reading it takes twice as long.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

LINE_BYTES = 64

Table = Mapping[str, tuple[Any, ...]]
"""Named arrays: name -> its type of numbers, then its shape, of numbers and of names of sizes."""


def aligned_zeros(shape: int | tuple[int, ...], dtype: DTypeLike = float) -> NDArray[Any]:
    """Return an array of zeros that begins at a cache line."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    flat = np.zeros(size + LINE_BYTES, np.uint8)
    first = -flat.ctypes.data % LINE_BYTES
    return flat[first : first + size].view(dtype).reshape(shape)


def aligned(a: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of `a` that begins at a cache line."""
    made = aligned_zeros(a.shape, a.dtype)
    made[...] = a
    return made


def named_arrays(name: str, arrays: Iterable[str], module: str) -> Any:
    """Return the named tuple `name` of arrays with these names. It has to be a variable of this name in the
    module, where the compiler finds it."""
    return namedtuple(name, list(arrays), module=module)


def zeros(table: Table, **sizes: int) -> dict[str, NDArray[Any]]:
    """Return name -> array of zeros for each row of a table. sizes: the numbers for the names in its shapes."""
    return {
        name: aligned_zeros(tuple(sizes[k] if isinstance(k, str) else k for k in shape), kind)
        for name, (kind, *shape) in table.items()
    }
