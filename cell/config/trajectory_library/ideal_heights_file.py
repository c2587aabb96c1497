"""Read and write the heights of ideal folds, which `foldcell library build` computes beside the trajectories."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, fields
from importlib import resources
from pathlib import Path
from typing import Any

from foldcell.cell.config.trajectory_library.library_file import alone_with, user_heights_path, write_text
from foldcell.skills.fold_plan.ideal_heights import IdealFoldHeights
from foldcell.skills.garments.garment import Garment

SCHEMA = 1
FIELDS = tuple(f.name for f in fields(IdealFoldHeights))


def shipped_heights_path() -> Path:
    return Path(str(resources.files("foldcell.cell.config.trajectory_library") / "ideal_heights.json"))


def ideal_heights_of(garment: Garment, library: Path | None = None) -> tuple[IdealFoldHeights, ...]:
    """Return the heights of a garment's ideal folds, in order of the bending length; empty if they were not
    computed for this fabric and size. library: the user's library; its heights come first. An unreadable file
    counts as empty."""
    paths = [] if library is None else [user_heights_path(library)]
    for path in (*paths, shipped_heights_path()):
        found = _heights(_read(path).get(garment.name), garment)
        if found:
            return found
    return ()


def _heights(entry: Any, garment: Garment) -> tuple[IdealFoldHeights, ...]:
    """Return the heights of a file's entry; empty if it is damaged or of another fabric or size."""
    try:
        if entry["of"] != _identity(garment):
            return ()
        found = tuple(IdealFoldHeights(**{k: float(row[k]) for k in FIELDS}) for row in entry["heights"])
    except (KeyError, TypeError, ValueError):
        return ()
    return found if all(math.isfinite(v) for h in found for v in astuple(h)) else ()


def put_ideal_heights(path: Path, garment: Garment, heights: Sequence[IdealFoldHeights]) -> None:
    """Store the heights of a garment. Raises StorageError."""
    rows = [{name: round(value, 6) for name, value in asdict(h).items()} for h in heights]
    with alone_with(path):
        known = {**_read(path), garment.name: {"of": _identity(garment), "heights": rows}}
        write_text(path, json.dumps({"schema": SCHEMA, "garments": dict(sorted(known.items()))}, indent=1) + "\n")


def _identity(garment: Garment) -> dict[str, Any]:
    """Return everything that the heights depend on, as plain values."""
    m = garment.material
    return {
        "size_m": [round(s, 6) for s in garment.size_m],
        "areal_mass": m.areal_mass,
        "bending_length": m.bending_length,
        "thickness": m.thickness,
        "fabric": garment.fabric.name if garment.fabric else None,
        "steps": [step.name for step in garment.plan],
    }


def _read(path: Path) -> Mapping[str, Any]:
    """Return the entries of a file; empty if it is missing or damaged."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    garments = data.get("garments") if isinstance(data, dict) and data.get("schema") == SCHEMA else None
    return garments if isinstance(garments, dict) else {}
