"""Where the Rerun viewer is, the program that opens recordings."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

__all__ = ["find_viewer"]


def find_viewer() -> Path | None:
    """The viewer that came with rerun-sdk: beside this interpreter, or on the path."""
    beside = Path(sys.executable).parent / "rerun"
    if beside.is_file():
        return beside
    found = shutil.which("rerun")
    return Path(found) if found else None
