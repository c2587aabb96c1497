"""Key points that a person has read off a photograph, as a YAML or JSON file: name -> [column, row] in pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely

from cell.config.yaml_file import Document, read_yaml
from robots.errors import ConfigurationError
from robots.ports import Array
from skills.garments.garment import Garment

__all__ = ["read_key_points"]

PROPORTIONS = 0.35
"""Largest difference from the proportions of the known garment: standard deviation, over the outline's edges, of
the logarithm of their relative length."""


def read_key_points(path: Path, like: Garment, columns: int, rows: int) -> Array:
    """Return the key points (k, 2) in pixels of a picture of that size, in the order of the garment `like`.

    Raises ConfigurationError with file, line, key and value for a name that is missing or unknown, a place outside
    the picture, an outline that crosses itself or runs the wrong way, and proportions unlike the garment's.
    """
    document = read_yaml(path, "file of key points")
    missing = [name for name in like.keypoints if name not in document.data]
    unknown = [name for name in document.data if name not in like.keypoints]
    if missing or unknown:
        wrong = [f"{name} is missing" for name in missing]
        wrong += [f"{document.where((name,))}: {name} is unknown" for name in unknown]
        raise ConfigurationError(
            f"{path}: {', '.join(wrong)}",
            f"the key points of {like.name} are {', '.join(like.keypoints)}",
            path=str(path),
        )
    points = np.array([_place(document, name, columns, rows) for name in like.keypoints])
    outline = shapely.Polygon(points)
    if not outline.is_valid or outline.area < 1.0:
        raise ConfigurationError(
            f"{path}: the outline through the key points crosses itself or has no area "
            f"({shapely.is_valid_reason(outline)})",
            f"they follow the outline in this order: {', '.join(like.keypoints)}",
        )
    if outline.exterior.is_ccw:  # rows count downwards
        raise ConfigurationError(
            f"{path}: the key points run clockwise", "exchange left and right; left is the garment's own, as laid"
        )
    _check_proportions(path, points, like)
    return points


def _place(document: Document, name: str, columns: int, rows: int) -> tuple[float, float]:
    value: Any = document.data[name]
    where = f"{document.where((name,))}: {name} = {value}"
    numbers = isinstance(value, list) and len(value) == 2 and all(type(v) in (int, float) for v in value)
    if not numbers or not np.isfinite(value).all():
        raise ConfigurationError(where, "a place in the picture is [column, row] in pixels")
    if not (0 <= value[0] < columns and 0 <= value[1] < rows):
        raise ConfigurationError(where, f"the picture has {columns} columns and {rows} rows")
    return float(value[0]), float(value[1])


def _check_proportions(path: Path, points: Array, like: Garment) -> None:
    lengths = [np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1) for p in (points, like.template)]
    relative = np.log(lengths[0] / lengths[1])
    relative -= np.median(relative)
    if float(relative.std()) <= PROPORTIONS:
        return
    worst = int(np.argmax(np.abs(relative)))
    names = like.keypoints[worst], like.keypoints[(worst + 1) % len(like.keypoints)]
    raise ConfigurationError(
        f"{path}: the key points have not the proportions of {like.name}: from {names[0]} to {names[1]} it is "
        f"{np.exp(relative[worst]):.1f} times as far, compared with the other edges",
        "correct these key points, or choose another garment with --like",
    )
