"""Arrays that begin where a line of the cache does.

A register is as long as a line or half of it: from an array that begins elsewhere (as most do, and elsewhere in
each process) every one or every second one is read from two lines, which takes twice as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["LINE_BYTES", "aligned", "aligned_zeros"]

LINE_BYTES = 64


def aligned_zeros(shape: int | tuple[int, ...], dtype: DTypeLike = float) -> NDArray[Any]:
    """Zeros at a line's beginning."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    flat = np.zeros(size + LINE_BYTES, np.uint8)
    first = -flat.ctypes.data % LINE_BYTES
    return flat[first : first + size].view(dtype).reshape(shape)


def aligned(a: NDArray[Any]) -> NDArray[Any]:
    """A copy at a line's beginning."""
    made = aligned_zeros(a.shape, a.dtype)
    made[...] = a
    return made
