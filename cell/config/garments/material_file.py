"""Insert measured values into a copy of a garment file. Comments and layout are preserved where possible."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from foldcell.cell.config.garments.garment_file import DEFAULT_SURFACE, parse_garment
from foldcell.cell.config.yaml_file import parse_yaml


def with_material(
    text: str,
    name: str,
    values: Mapping[str, Any],
    measured: Mapping[str, str],
    no_longer_assumed: Sequence[str],
    surface: str = DEFAULT_SURFACE,
) -> str:
    """Return the garment file `text` with `values` under `material` and their origin under `material.measured`.

    A value that is a mapping is merged with the existing mapping. no_longer_assumed: names to remove from
    `material.assumed`. name: stem of the file name, for messages. Raises ConfigurationError if the result is not a
    valid garment file.
    """
    file = Path(f"{name}.yaml")
    wanted = dict(parse_yaml(text, file, "garment file").data)
    material = copy.deepcopy(wanted.get("material") or {})
    changed = {key: _merged(material.get(key), value) for key, value in values.items()}
    changed["measured"] = _merged(material.get("measured"), dict(measured))
    if any(field in no_longer_assumed for field in material.get("assumed", [])):
        changed["assumed"] = [field for field in material["assumed"] if field not in no_longer_assumed]
    wanted["material"] = material | changed
    edited = _edited(text, changed)
    if parse_yaml(edited, file, "garment file").data != wanted:  # the layout does not allow editing by lines
        edited = yaml.safe_dump(wanted, sort_keys=False, allow_unicode=True)
    parse_garment(file, edited, surface)
    return edited


def _merged(old: Any, new: Any) -> Any:
    return {**old, **new} if isinstance(old, Mapping) and isinstance(new, Mapping) else new


def _edited(text: str, changed: Mapping[str, Any]) -> str:
    """Return `text` with `changed` in the block `material:`, one line per key. The existing lines of these keys
    are replaced."""
    lines = text.splitlines()
    start = next((i for i, line in enumerate(lines) if re.match(r"material:\s*(#.*)?$", line)), None)
    if start is None:
        return text
    end = start + 1
    while end < len(lines) and (not lines[end].strip() or lines[end][0] in " #"):
        end += 1
    block = lines[start + 1 : end]
    stated = (line for line in block if line.strip() and not line.lstrip().startswith("#"))
    indent = next((len(line) - len(line.lstrip()) for line in stated), 2)
    for key, value in changed.items():
        flow = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
        line = " " * indent + f"{key}: {flow.removesuffix('...' + chr(10)).strip()}"
        first = next((i for i, old in enumerate(block) if re.match(rf" {{{indent}}}{key}:", old)), None)
        if first is None:
            block.append(line)
            continue
        last = first + 1
        while last < len(block) and len(block[last]) - len(block[last].lstrip()) > indent:
            last += 1
        block[first:last] = [line]
    return "\n".join([*lines[: start + 1], *block, *lines[end:]]) + "\n"
