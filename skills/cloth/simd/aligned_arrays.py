"""Allocates arrays that begin at a cache line.

A SIMD register is as long as a cache line (64 bytes) or half as long. In an array that does not begin at a cache
line, every register or every second register spans two lines, and reading it takes twice as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["LINE_BYTES", "aligned", "aligned_zeros"]

LINE_BYTES = 64


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
