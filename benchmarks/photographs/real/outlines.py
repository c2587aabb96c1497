"""Outlines of garments with the key points that a tailor would mark, and smooth warps of them.

`benchmarks/real_outlines` holds outlines measured from public pictures of real garments (shop pictures, front
view), as polygons in units of the garment's height, x to the right and y up; `traced.json` holds their key points.
`sewn.json` holds outlines drawn after size charts, as right halves in centimetres: [name, x from the middle, y up]
and "smooth" where there is no corner.

A mark is the number of a vertex; 3.5 is halfway between the vertices 3 and 4. Marked are: the ends of each hem;
the armpit where the side seam meets the sleeve; the two ends of a sleeve's opening; the shoulder at the end of the
shoulder's seam, on the rounding where the seam is not a corner; the collar where the shoulder's seam meets the
neck: a collar that stands above it belongs to the outline but holds no key point.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from shapely.geometry import Polygon

from benchmarks import real_outlines
from benchmarks.photographs.outline import Points

STEP_M = 0.002
"""Distance of the points of an outline."""
CORNER_DEG = 40.0
"""A vertex of a traced polygon that turns by more is a corner; the others lie on a curve."""
MOST = 0.15
"""A warp scales each measure by up to this."""
PAIRS = (("left", "right"), ("near", "far"))


@dataclass(frozen=True, eq=False)
class Base:
    """One outline as it is stored. points: (n, 2) [m], x from hem to collar or to the waist, y to the left.
    corners: which points are corners. marks: place of each key point as the number of a vertex. stand: with a
    collar that stands above the shoulders. traced: measured from a picture of a real garment."""

    name: str
    category: str
    points: Points
    corners: tuple[bool, ...]
    marks: Mapping[str, float]
    stand: bool
    traced: bool


@dataclass(frozen=True, eq=False)
class Flat:
    """A garment's outline (n, 2) [m] with the indices of its key points. diagonal_m: of its bounding box in its
    own frame."""

    base: str
    category: str
    outline: Points
    at: Mapping[str, int]
    diagonal_m: float
    stand: bool = False

    @property
    def keypoints(self) -> dict[str, Points]:
        return {name: self.outline[i] for name, i in self.at.items()}

    def arc(self, first: str, last: str) -> Points:
        """The shorter part of the outline between two key points, both included."""
        n, a, b = len(self.outline), self.at[first], self.at[last]
        ahead = self.outline[(a + np.arange((b - a) % n + 1)) % n]
        back = self.outline[(a - np.arange((a - b) % n + 1)) % n]
        return ahead if _length(ahead) <= _length(back) else back


@cache
def bases() -> dict[str, Base]:
    """All outlines by name; those of real garments first."""
    found = {}
    for file, read in (("traced.json", _traced), ("sewn.json", sewn)):
        for name, entry in json.loads((Path(__file__).parent / file).read_text()).items():
            found[name] = read(name, entry)
    return found


def _traced(name: str, entry: Mapping[str, Any]) -> Base:
    low, high = entry["height_m"]
    drawn = np.array(_measured()[name]["outline"])
    points = np.column_stack([drawn[:, 1] - 0.5, -drawn[:, 0]]) * (low + high) / 2
    ahead, behind = np.roll(points, -1, axis=0) - points, points - np.roll(points, 1, axis=0)
    turn = np.arctan2(behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0], np.sum(ahead * behind, axis=1))
    ends = {round(m) for part, m in entry["marks"].items() if not part.startswith("shoulder")}
    corners = tuple(bool(abs(turn[i]) > np.radians(CORNER_DEG)) or i in ends for i in range(len(points)))
    return Base(name, entry["category"], points, corners, entry["marks"], entry.get("stand", False), True)


@cache
def _measured() -> dict[str, Any]:
    return dict(json.loads((Path(real_outlines.__file__).parent / "outlines.json").read_text()))


def sewn(name: str, entry: Mapping[str, Any]) -> Base:
    """An outline from its right half, and its left one where that is given, else mirrored."""
    half = entry["half_cm"]
    other = entry.get("other_half_cm", half)
    sides = ("far", "near") if entry["category"] in ("pants", "shorts") else ("right", "left")
    points, corners, marks = [], [], {}
    for side, sign, nodes in ((sides[0], 1, half), (sides[1], -1, other[-2:0:-1])):
        for node in nodes:
            label, x, y = node[:3]
            if label:
                marks[label if x == 0 else f"{label}_{side}"] = float(len(points))
            points.append((y / 100, -sign * x / 100))
            corners.append(len(node) == 3 and (x != 0 or bool(label)))
    placed = np.array(points)
    placed[:, 0] -= (placed[:, 0].min() + placed[:, 0].max()) / 2
    return Base(name, entry["category"], placed, tuple(corners), marks, entry.get("stand", False), False)


def flat(base: Base, softness_m: float = 0.0) -> Flat:
    """The outline with many points: curves through smooth vertices, corners rounded by `softness_m`."""
    dense, places = _dense(base)
    if softness_m > 0:
        dense = gaussian_filter1d(dense, softness_m / STEP_M, axis=0, mode="wrap")
    at = {}
    for name, mark in base.marks.items():
        low = int(mark)
        at[name] = round(float(places[low] + (mark - low) * (places[low + 1] - places[low]))) % len(dense)
    return Flat(base.name, base.category, dense, at, _diagonal(dense), base.stand)


def _dense(base: Base) -> tuple[Points, list[int]]:
    """Points at even distances, and the index of each vertex among them (the first one again at the end)."""
    n = len(base.points)
    first = base.corners.index(True)
    places = [0] * (n + 1)
    pieces: list[Points] = []
    count, i = 0, 0
    while i < n:
        run = [i]
        while True:
            run.append(run[-1] + 1)
            if base.corners[(first + run[-1]) % n]:
                break
        vertices = base.points[[(first + k) % n for k in run]]
        chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices, axis=0), axis=1) ** 0.7)])
        curve = CubicSpline(chord, vertices, bc_type="natural")
        for k in range(len(run) - 1):
            steps = max(2, round(float(np.linalg.norm(vertices[k + 1] - vertices[k])) / STEP_M))
            places[run[k]] = count
            pieces.append(curve(np.linspace(chord[k], chord[k + 1], steps, endpoint=False)))
            count += steps
        i = run[-1]
    places[n] = count
    # Vertex j of the base is vertex j - first here.
    shifted = [places[(j - first) % n] for j in range(n)]
    return np.vstack(pieces), [*shifted, shifted[0] + (count if shifted[0] < shifted[-1] else 0)]


def warped(rng: np.random.Generator, whole: Flat) -> Flat:
    """The outline scaled along and across, tapered, sheared, bent and waved; half of them mirrored. Its key points
    move along. A warp that makes the outline cross itself is not taken."""
    if rng.random() < 0.5:
        whole = mirrored(whole)
    for weaker in 0.9 ** np.arange(40):
        outline = _warp(rng, whole.outline, float(weaker))
        if Polygon(outline).is_valid:
            return Flat(whole.base, whole.category, outline, whole.at, _diagonal(outline), whole.stand)
    raise ValueError(f"no warp of {whole.base} keeps its edges apart")


def _warp(rng: np.random.Generator, points: Points, weaker: float) -> Points:
    most = MOST * weaker
    size = float(np.ptp(points[:, 0]))
    x, y = points.T
    along, across, taper = rng.uniform(-most, most, 3)
    shear, bend = rng.uniform(-most, most, 2) * [0.5, 0.4]
    level = x / size  # -0.5 at the hem, 0.5 at the collar
    warped_x = x * (1 + along)
    warped_y = y * (1 + across) * (1 + taper * level) + shear * x + bend * size * (level**2 - 0.08)
    drawn = np.column_stack([warped_x, warped_y])
    for scale, amount in ((0.45, 0.008), (0.18, 0.0012)):  # waves as long as the body, and as a hand
        drawn = drawn + weaker * amount * size * _waves(rng, points, scale * size)
    return np.asarray(drawn)


def _waves(rng: np.random.Generator, points: Points, length: float) -> Points:
    """A smooth random field of unit deviation at the points, both of its coordinates."""
    total = np.zeros_like(points)
    for _ in range(12):
        direction = rng.normal(0, 2 * np.pi / length / 2, 2)
        total += rng.normal(0, 1, 2) * np.cos(points @ direction + rng.uniform(0, 2 * np.pi))[:, None]
    return np.asarray(total * np.sqrt(2 / 12))


def mirrored(whole: Flat) -> Flat:
    """The garment seen from its other side."""
    return Flat(
        whole.base,
        whole.category,
        np.ascontiguousarray(whole.outline * [1, -1]),
        {_other_side(name): i for name, i in whole.at.items()},
        whole.diagonal_m,
        whole.stand,
    )


def _other_side(name: str) -> str:
    stem, _, side = name.rpartition("_")
    for a, b in PAIRS:
        if side in (a, b):
            return f"{stem}_{b if side == a else a}"
    return name


def _diagonal(outline: Points) -> float:
    return float(np.linalg.norm(np.ptp(outline, axis=0)))


def _length(line: Points) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
