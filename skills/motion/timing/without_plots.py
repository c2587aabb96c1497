"""Import toppra without Matplotlib, which only its plots need and whose import takes longer than toppra's."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

NAMES = ("matplotlib", "matplotlib.pyplot")


@contextmanager
def without_plots() -> Iterator[None]:
    """Let modules import an empty Matplotlib, unless it is already imported. Later imports are as usual."""
    if NAMES[0] in sys.modules:
        yield
        return
    sys.modules.update((name, ModuleType(name)) for name in NAMES)
    try:
        yield
    finally:
        for name in NAMES:
            del sys.modules[name]
