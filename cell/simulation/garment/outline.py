"""The true outline of a garment: an outline from outlines.yaml with random errors of size and shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.cell.simulation.noise import GarmentNoise
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import Array

PATH = Path(__file__).with_name("outlines.yaml")
ARC_POINTS = 4
EDGE_POINTS = 5


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of one garment. contour: (k, 2) counter-clockwise. keypoints: name -> (2,), on the contour.
    Garment frame [m]."""

    contour: Array
    keypoints: Mapping[str, Array]


@lru_cache(maxsize=1)
def _file() -> Mapping[str, Any]:
    return read_yaml(PATH, "file of outlines").data


def draw_outline(garment: Garment, noise: GarmentNoise, rng: np.random.Generator, ideal: bool = False) -> Outline:
    """Draw the random outline of one piece of `garment`. ideal: nominal size and shape."""
    points = _points(garment)
    share = 0.0 if ideal else 1.0
    scale = 1.0 + share * noise.size * rng.uniform(-1.0, 1.0, 2)
    shift = share * noise.asymmetry * rng.uniform(-1.0, 1.0, (len(points), 2))
    corners = np.array([p["at"] for p in points], dtype=np.float64) * scale + shift
    arcs = [
        _round(corners[i - 1], corners[i], corners[(i + 1) % len(corners)], points[i]["radius"])
        for i in range(len(corners))
    ]
    pieces, keypoints = [], {}
    for i, arc in enumerate(arcs):
        pieces.append(arc)
        pieces.append(_bowed(arc[-1], arcs[(i + 1) % len(arcs)][0], points[i]["bow"]))
        if points[i]["name"] is not None:
            keypoints[points[i]["name"]] = 0.5 * (arc[(len(arc) - 1) // 2] + arc[len(arc) // 2])
    return Outline(np.concatenate(pieces), keypoints)


def _points(garment: Garment) -> list[dict[str, Any]]:
    file = _file()
    plain = {"name": None, "radius": file["default_radius"], "bow": file["default_bow"]}
    if garment.name in file and _ships(garment):
        return [{**plain, **point} for point in file[garment.name]]
    return [
        {**plain, "name": name, "at": point.tolist()}
        for name, point in zip(garment.keypoints, garment.template, strict=True)
    ]


def _ships(garment: Garment) -> bool:
    """Whether this is the shipped garment with this name. A user's file may have the same name."""
    shipped = load_garment(garment.name)
    return garment.keypoints == shipped.keypoints and np.array_equal(garment.template, shipped.template)


def _round(before: Array, corner: Array, after: Array, radius: float) -> Array:
    """Round a corner: return points (ARC_POINTS, 2) on an arc of `radius` [m] that touches both edges. If an edge
    is short, the arc is smaller. A corner of more than 160 degrees stays as it is: (1, 2)."""
    a, b = before - corner, after - corner
    la, lb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    a, b = a / la, b / lb
    half = 0.5 * np.arccos(np.clip(a @ b, -1.0, 1.0))
    if radius <= 0.0 or half > np.radians(80.0):
        return corner[None, :]
    reach = min(float(radius / np.tan(half)), 0.4 * la, 0.4 * lb)
    s = np.linspace(0.0, 1.0, ARC_POINTS)[:, None]
    start, end = corner + reach * a, corner + reach * b
    weight = np.sin(half)  # a rational quadratic Bezier with this weight is the circle's arc
    top = (1 - s) ** 2 * start + 2 * weight * s * (1 - s) * corner + s**2 * end
    return top / ((1 - s) ** 2 + 2 * weight * s * (1 - s) + s**2)


def _bowed(start: Array, end: Array, bow: float) -> Array:
    """Return points (EDGE_POINTS, 2) between the ends, on a parabola whose middle is `bow` [m] to the right of the
    chord."""
    s = np.linspace(0.0, 1.0, EDGE_POINTS + 2)[1:-1, None]
    chord = end - start
    outwards = np.array([chord[1], -chord[0]]) / np.linalg.norm(chord)
    return start + s * chord + 4.0 * s * (1.0 - s) * bow * outwards
