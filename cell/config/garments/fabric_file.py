"""Read skills/garments/fabrics/fabrics.yaml, the classes of fabrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from foldcell.cell.config.yaml_file import read_yaml
from foldcell.skills.garments.garment import Fabric, Span

PATH = Path(str(resources.files("foldcell.skills.garments.fabrics") / "fabrics.yaml"))
PROPERTIES = tuple(f.name for f in fields(Fabric) if f.name not in {"name", "title", "sources"})


@lru_cache(maxsize=1)
def load_fabrics() -> Mapping[str, Fabric]:
    """Return all classes by name."""
    table = read_yaml(PATH, "file of fabrics").data
    return {name: _fabric(name, entry) for name, entry in table.items()}


def _fabric(name: str, entry: Mapping[str, Any]) -> Fabric:
    spans = {key: _span(entry[key]["range"]) for key in PROPERTIES}
    return Fabric(name, entry["title"], **spans, sources={key: entry[key]["source"] for key in PROPERTIES})


def _span(ends: Sequence[float]) -> Span:
    low, high = map(float, ends)
    return low, high
