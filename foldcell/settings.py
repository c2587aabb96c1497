"""Read the settings of the cell in all forms that the functions of this package accept."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from foldcell.arguments import path, plain
from foldcell.cell.config.cell_settings import CellSettings, load_settings, overlaid

Settings: TypeAlias = CellSettings | Mapping[str, Any] | Path | str | None
"""A settings file, a mapping of the values that differ from the shipped settings (as in a file: `{"optimiser":
{"method": "initial"}}`), loaded settings, or None for the shipped settings."""


def cell_settings(given: Settings) -> CellSettings:
    """Return the validated settings. File names in a mapping are relative to the working directory.

    Raises ConfigurationError for an unreadable file, an unknown key or a value out of range.
    """
    if given is None:
        return load_settings()
    if isinstance(given, Mapping):
        return overlaid(load_settings(), plain(given), Path("settings"), {})
    return given if isinstance(given, CellSettings) else load_settings(path(given, "settings"))
