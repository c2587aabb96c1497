"""Key points that a person has placed in a picture, as a YAML or JSON file: name -> [column, row] in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from foldcell.cell.config.yaml_file import Document, read_yaml
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment
from foldcell.skills.garments.key_point_check import KeyPointFinding, check_key_points
from foldcell.skills.garments.picture_measure import PictureMeasure


def read_key_points(path: Path, like: Garment) -> Document:
    """Read a file of key points, name -> [column, row], of which some may be missing.

    Raises ConfigurationError with file, line, key and value for a name that is not a key point of `like`, and for
    a value that is not a place in the picture.
    """
    document = read_yaml(path, "file of key points")
    for name, value in document.data.items():
        if name not in like.keypoints:
            known = f"the key points of {like.name} are {', '.join(like.keypoints)}"
            raise ConfigurationError(f"{document.where((name,))}: {name} is unknown", known, path=str(path))
        numbers = isinstance(value, list) and len(value) == 2 and all(type(v) in (int, float) for v in value)
        if not numbers or not np.isfinite(value).all():
            where = f"{document.where((name,))}: {name} = {value}"
            raise ConfigurationError(where, "a place in the picture is [column, row] in pixels", path=str(path))
    return document


def read_checked_key_points(
    path: Path, like: Garment, picture: PictureMeasure
) -> tuple[Array, tuple[KeyPointFinding, ...]]:
    """Return the key points (k, 2) in pixels of a picture, in the order of the garment `like`, and the findings
    that a person has to judge.

    Raises ConfigurationError, with file and line, if no garment can be made of them (`check_key_points`).
    """
    document = read_key_points(path, like)
    findings = check_key_points(document.data, like, picture)
    refused = [finding for finding in findings if finding.refused]
    if refused:
        lines = [f"{_where(document, finding)}: {finding.what}" for finding in refused]
        hints = dict.fromkeys(finding.hint for finding in refused)
        raise ConfigurationError("\n".join(lines), "\n  ".join(hints), path=str(path))
    return np.array([document.data[name] for name in like.keypoints], dtype=float), findings


def key_points_text(points: Mapping[str, Array], origin: str) -> str:
    """Return the text of a file of key points, name -> (2,) in pixels. origin: a line that states where they come
    from."""
    lines = (f"{name}: [{float(column):.2f}, {float(row):.2f}]\n" for name, (column, row) in points.items())
    return f"# {origin}\n{''.join(lines)}"


def _where(document: Document, finding: KeyPointFinding) -> str:
    known = tuple(name for name in finding.names if name in document.data)
    return document.where(known[:1])
