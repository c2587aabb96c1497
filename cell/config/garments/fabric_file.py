"""Read skills/garments/fabrics/fabrics.yaml, the classes of fabrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from foldcell.cell.config.yaml_file import read_yaml
from foldcell.robots.errors import InternalError
from foldcell.skills.garments.garment import Fabric, Span

__all__ = ["load_fabrics"]

PATH = Path(str(resources.files("foldcell.skills.garments.fabrics") / "fabrics.yaml"))
PROPERTIES = tuple(f.name for f in fields(Fabric) if f.name not in {"name", "title", "sources"})


@lru_cache(maxsize=1)
def load_fabrics() -> Mapping[str, Fabric]:
    """Return all classes by name. Raises InternalError if the file does not match `Fabric`."""
    table = read_yaml(PATH, "file of fabrics").data
    return {name: _fabric(name, entry) for name, entry in table.items()}


def _fabric(name: str, entry: Mapping[str, Any]) -> Fabric:
    if set(entry) != {"title", *PROPERTIES}:
        raise InternalError(f"{PATH.name}: {name} differs by {sorted(set(entry) ^ {'title', *PROPERTIES})}")
    spans = {key: _span(f"{name}.{key}", entry[key]) for key in PROPERTIES}
    return Fabric(name, entry["title"], **spans, sources={key: entry[key]["source"] for key in PROPERTIES})


def _span(where: str, value: Mapping[str, Any]) -> Span:
    if set(value) != {"range", "unit", "source"}:
        raise InternalError(f"{PATH.name}: {where} needs range, unit and source")
    low, high = map(float, value["range"])
    if not 0.0 < low <= high:
        raise InternalError(f"{PATH.name}: {where}: the range {low} to {high} is not ordered")
    return low, high
