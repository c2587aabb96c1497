"""Convert values to JSON, and flatten JSON values."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from foldcell.cell.support.files.whole_file import write_whole


def to_json(value: Any) -> Any:
    """Convert `value` to plain JSON values: dataclasses and pydantic's models to mappings, arrays to lists, enums
    to their values, numbers that are not finite to null, other objects to the name of their type. Never raises,
    because a log entry must not end a run."""
    if value is None or (isinstance(value, bool | str) and not isinstance(value, Enum)):
        return value
    if isinstance(value, Enum):
        return to_json(value.value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {_key(k): to_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        items = sorted(value, key=str) if isinstance(value, set | frozenset) else value
        return [to_json(v) for v in items]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, BaseModel):
        return to_json(dict(value))
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return to_json(value.tolist())
    if isinstance(value, Path):
        return str(value)
    return f"<{type(value).__name__}>"


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON for people and programs. Raises StorageError."""
    write_whole(path, json.dumps(to_json(value), indent=1) + "\n")


def _key(key: Any) -> str:
    return str(key.value) if isinstance(key, Enum) else str(key)


def flattened(value: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and values of nested mappings. Mappings in a list are numbered from 0, or named if they
    have a name; other lists are values."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from flattened(item, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, Sequence) and not isinstance(value, str) and any(isinstance(v, Mapping) for v in value):
        for n, item in enumerate(value):
            yield from flattened(item, f"{prefix}.{item.get('name', n)}")
    else:
        yield prefix, value
