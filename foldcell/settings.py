"""The settings of the cell, in each form that a caller may give them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Union

if TYPE_CHECKING:
    from cell.config.cell_settings import CellSettings

__all__ = ["Settings", "cell_settings"]

Settings: TypeAlias = Union["CellSettings", Mapping[str, Any], Path, str, None]
"""A settings file, a mapping of what differs from the shipped settings (as in a file: `{"optimiser": {"method":
"initial"}}`), settings that are loaded already, or None: the shipped ones."""


def cell_settings(given: Settings) -> CellSettings:
    """The validated settings. File names in a mapping are relative to the working directory.

    Raises ConfigurationError: unreadable file, unknown key, value out of range.
    """
    from cell.config.cell_settings import load_settings, overlaid

    if given is None or isinstance(given, str | Path):
        return load_settings(None if given is None else Path(given))
    if isinstance(given, Mapping):
        return overlaid(load_settings(), given, Path("settings"), {})
    return given
