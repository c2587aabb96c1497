"""The settings of a cell that differ from the shipped ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from foldcell.cell.config.cell_settings import CellSettings


def changed_settings(settings: CellSettings, shipped: CellSettings) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the keys whose values differ, as nested mappings: with the values of `settings`, and with the shipped
    values."""
    own, default = (s.model_dump(mode="json", by_alias=True) for s in (settings, shipped))
    return differing(own, default), differing(default, own)


def differing(values: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of `values` that `others` lacks or has with another value."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        other = others.get(key)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            if part := differing(value, other):
                found[key] = part
        elif key not in others or value != other:
            found[key] = value
    return found
