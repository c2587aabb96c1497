"""Finds the Rerun viewer, the program that opens recordings."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

__all__ = ["find_viewer", "silent_environment"]


def find_viewer() -> Path | None:
    """Return the viewer's path: beside this interpreter, or on the PATH; None if it is not installed."""
    beside = Path(sys.executable).parent / "rerun"
    if beside.is_file():
        return beside
    found = shutil.which("rerun")
    return Path(found) if found else None


def silent_environment() -> dict[str, str]:
    """Return the environment in which the viewer does not report its use to its makers. With CI set, it takes its
    run for an automatic test."""
    return {**os.environ, "CI": "1"}
