"""Returns free memory to the operating system between the runs of a long process."""

from __future__ import annotations

import ctypes
import gc


def return_free_memory() -> None:
    """Collect garbage and let the C library give back the memory that it keeps for later use.

    The threads of a run allocate from separate arenas. Without this call, the arenas of ended threads accumulate.
    Does nothing for a C library without `malloc_trim`, such as musl.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
