"""Finds the Rerun viewer, the program that opens recordings."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

__all__ = ["find_viewer"]


def find_viewer() -> Path | None:
    """Return the viewer's path: beside this interpreter, or on the PATH; None if it is not installed."""
    beside = Path(sys.executable).parent / "rerun"
    if beside.is_file():
        return beside
    found = shutil.which("rerun")
    return Path(found) if found else None
