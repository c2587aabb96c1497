"""The score of a simulated run: a comparison of the final garment with the target of its plan.

The scorer reads the world's truth (final vertices, flat rest shape), which neither the executive nor any skill can
see. Its result affects no decision of a run.

The target is the plan applied to the world's true rest shape. The mesh is cut along the fold lines, so that every
triangle lies on one side of each line, and is folded as a perfect isometry. One rigid alignment in the table plane
(area-weighted least squares over corresponding triangles, no reflection, no scale: Kabsch 1976) moves the final
shape onto the target. All shape figures are computed after this alignment. The alignment itself is the drift.

Lengths in metres, angles in radians, table frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from cell.simulation.scoring.folded_mesh import doubled_area, fold_mesh
from cell.simulation.scoring.table_raster import TableRaster
from robots.errors import InternalError
from skills.garments.garment import Garment
from skills.planning.folding import fold_xy
from skills.planning.plan import ways_to_fold
from skills.vocabulary import Array, FoldLine

__all__ = [
    "Figure",
    "FinalGarment",
    "Score",
    "ScoreLimits",
    "diagonal",
    "named_edge_pairs",
    "score",
    "score_plan",
]

EDGE_SPACING = 0.005  # distance between samples along a pair of edges [m]
LARGEST_EXTENT = 5.0  # a wider garment is an error of the simulation [m]


@dataclass(frozen=True, eq=False)
class FinalGarment:
    """The world's truth after a run. Lengths [m], table frame.

    vertices: (n, 3) final positions. triangles: (m, 3). material: (n, 2) the flat rest shape in the pose in which
    it was laid. lines: the plan's fold lines in order, computed from the true key points of that rest shape.
    thickness: of one layer. edge_pairs: pairs of polylines (k, 2), (l, 2) in material coordinates. The
    corresponding points of a pair should meet.
    """

    vertices: Array
    triangles: NDArray[np.int32]
    material: Array
    lines: tuple[FoldLine, ...]
    thickness: float
    edge_pairs: tuple[tuple[Array, Array], ...] = ()


@dataclass(frozen=True)
class ScoreLimits:
    """Limits of the figures for a pass. correspondence: fraction of the garment's diagonal; height: above the flat
    stack [m]; edges, drift [m]; drift_angle [rad]."""

    iou: float = 0.90
    correspondence: float = 0.025
    edges: float = 0.030
    height: float = 0.010
    drift: float = 0.050
    drift_angle: float = math.radians(10.0)
    crease_margin: float = 0.040
    """The height is not measured within this distance of a fold line, where unpressed cloth bulges [m]."""


DEFAULT_LIMITS = ScoreLimits()


@dataclass(frozen=True)
class Figure:
    """One figure and its limit. at_least: the figure must be at least the limit; else at most the limit."""

    value: float
    limit: float
    at_least: bool = False

    @property
    def passed(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Score:
    """The figures by name, and the verdict. layers: number of layers in the stack of the flat target."""

    figures: Mapping[str, Figure]
    layers: int

    @property
    def passed(self) -> bool:
        return all(f.passed for f in self.figures.values())

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the figures that do not pass their limit."""
        return tuple(name for name, f in self.figures.items() if not f.passed)

    @property
    def iou(self) -> float:
        return self.figures["iou"].value

    @property
    def correspondence_m(self) -> float:
        return self.figures["correspondence_m"].value

    @property
    def edges_m(self) -> float:
        return self.figures["edges_m"].value

    @property
    def height_m(self) -> float:
        return self.figures["height_m"].value

    @property
    def drift_m(self) -> float:
        return self.figures["drift_m"].value

    @property
    def drift_rad(self) -> float:
        return self.figures["drift_rad"].value

    def to_json(self) -> dict[str, Any]:
        """Plain values: `passed`, each figure, `limits` with the limit of each figure, and `layers`."""
        return {
            "passed": self.passed,
            **{name: f.value for name, f in self.figures.items()},
            "limits": {name: f.limit for name, f in self.figures.items()},
            "layers": self.layers,
        }


def score(garment: FinalGarment, limits: ScoreLimits = DEFAULT_LIMITS) -> Score:
    """Score a folded garment. Raises InternalError if its vertices are not finite or too far apart."""
    _check(garment)
    folded = fold_mesh(garment.material, garment.triangles, garment.lines, garment.vertices)
    final, corners = folded.attributes, folded.triangles
    centres, target_centres = final[corners, :2].mean(axis=1), folded.target[corners].mean(axis=1)
    align, drift, turn = _align(centres, target_centres, folded.area)
    error = np.linalg.norm(align(centres) - target_centres, axis=1)

    aligned = np.column_stack([align(final[:, :2]), final[:, 2]])
    grid = TableRaster.around(np.vstack([aligned[:, :2], folded.target]))
    top, _ = grid.render(aligned, corners)
    _, count = grid.render(np.column_stack([folded.target, np.zeros(len(aligned))]), corners)
    silhouette, wanted = np.isfinite(top), count > 0
    flat = grid.away_from(folded.creases, limits.crease_margin)
    layers = _percentile(count, wanted, flat)

    figures = {
        "iou": Figure(float((silhouette & wanted).sum() / (silhouette | wanted).sum()), limits.iou, at_least=True),
        "correspondence_m": Figure(
            float(np.average(error, weights=folded.area)), limits.correspondence * diagonal(garment.material)
        ),
        "edges_m": Figure(_largest_edge_distance(garment, align), limits.edges),
        "height_m": Figure(_percentile(top, silhouette, flat), layers * garment.thickness + limits.height),
        "drift_m": Figure(float(np.linalg.norm(drift)), limits.drift),
        "drift_rad": Figure(abs(turn), limits.drift_angle),
    }
    return Score(figures, round(layers))


def score_plan(
    vertices: Array,
    triangles: NDArray[np.int32],
    material: Array,
    keypoints: Mapping[str, Array],
    garment: Garment,
    thickness: float,
    limits: ScoreLimits = DEFAULT_LIMITS,
) -> Score:
    """Score a folded garment against its plan. keypoints: the true key points, name -> (2,) material coordinates.

    A step of a plan may have several variants (either half onto the other). The garment is scored against the
    combination of variants whose target is nearest to its final shape, measured without alignment. Raises
    InternalError like `score`.
    """
    pairs = named_edge_pairs(garment.edge_pairs, keypoints)
    finals = [
        FinalGarment(vertices, triangles, material, lines, thickness, pairs)
        for lines in ways_to_fold(garment, keypoints)
    ]
    return score(min(finals, key=_mean_distance), limits)


def _mean_distance(garment: FinalGarment) -> float:
    target = fold_xy(garment.lines, garment.material)
    return float(np.linalg.norm(garment.vertices[:, :2] - target, axis=1).mean())


def named_edge_pairs(
    pairs: Sequence[tuple[Sequence[str], Sequence[str]]], keypoints: Mapping[str, Array]
) -> tuple[tuple[Array, Array], ...]:
    """Return the edge pairs of a garment file as polylines between the garment's true key points."""
    return tuple(
        (np.array([keypoints[n] for n in a], dtype=float), np.array([keypoints[n] for n in b], dtype=float))
        for a, b in pairs
    )


def diagonal(material: Array) -> float:
    """Return the largest distance between two points of the rest shape (n, 2) [m]. For a rectangle it is the
    diagonal."""
    return float(pdist(material[ConvexHull(material).vertices]).max())


def _check(garment: FinalGarment) -> None:
    x = garment.vertices
    bad = int((~np.isfinite(x)).any(axis=1).sum())
    if bad:
        raise InternalError("the world's garment has vertices that are not finite", vertices=bad)
    extent = float(np.ptp(x, axis=0).max())
    if extent > LARGEST_EXTENT:
        raise InternalError("the world's garment has exploded", extent_m=extent, largest_m=LARGEST_EXTENT)


class _Align:
    """The rigid motion p -> R (p - source) + target in the plane."""

    def __init__(self, source: Array, target: Array, angle: float) -> None:
        c, s = math.cos(angle), math.sin(angle)
        self.source, self.target, self.rotation = source, target, np.array([[c, -s], [s, c]])

    def __call__(self, xy: Array) -> Array:
        return (xy - self.source) @ self.rotation.T + self.target


def _align(xy: Array, target: Array, weight: Array) -> tuple[_Align, Array, float]:
    """Return the rigid motion of xy onto the target, the drift of the centroid (2,) [m] and the turn of the shape
    [rad]."""
    a, b = np.average(xy, axis=0, weights=weight), np.average(target, axis=0, weights=weight)
    p, q = xy - a, target - b
    dot = float(weight @ (p * q).sum(axis=1))
    cross = float(weight @ (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
    angle = math.atan2(cross, dot)
    return _Align(a, b, angle), a - b, -angle


def _largest_edge_distance(garment: FinalGarment, align: _Align) -> float:
    largest = 0.0
    for first, second in garment.edge_pairs:
        n = 1 + math.ceil(max(_length(first), _length(second)) / EDGE_SPACING)
        a, b = (align(_where_now(garment, _resample(p, n))) for p in (first, second))
        largest = max(largest, float(np.linalg.norm(a - b, axis=1).max()))
    return largest


def _length(polyline: Array) -> float:
    return float(np.linalg.norm(np.diff(polyline, axis=0), axis=1).sum())


def _resample(polyline: Array, n: int) -> Array:
    """Return n evenly spaced points on a polyline."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(polyline, axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], n)
    return np.column_stack([np.interp(at, s, polyline[:, 0]), np.interp(at, s, polyline[:, 1])])


def _where_now(garment: FinalGarment, material: Array) -> Array:
    """Return the present positions (k, 2) of material points (k, 2). A point beside the cloth is replaced by the
    nearest point of the cloth, because true outlines have round corners and key points are often just beside the
    cloth."""
    return np.array([_interpolate(garment, p) for p in material])


def _interpolate(garment: FinalGarment, p: Array) -> Array:
    triangles, rest, now = garment.triangles, garment.material, garment.vertices[:, :2]
    a, b, c = (rest[triangles[:, k]] for k in range(3))
    area = doubled_area(rest, triangles)
    w = np.column_stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)]) / area[:, None]
    inside = np.flatnonzero(w.min(axis=1) >= -1e-9)
    if len(inside):
        return w[inside[0]] @ now[triangles[inside[0]]]
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    start, along = rest[edges[:, 0]], rest[edges[:, 1]] - rest[edges[:, 0]]
    u = np.clip(((p - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    k = int(np.linalg.norm(start + u[:, None] * along - p, axis=1).argmin())
    i, j = edges[k]
    return (1.0 - u[k]) * now[i] + u[k] * now[j]


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _percentile(image: NDArray[Any], silhouette: NDArray[np.bool_], flat: NDArray[np.bool_]) -> float:
    """Return the 95th percentile over the silhouette away from the creases, or over all of it if all pixels are
    near creases."""
    where = silhouette & flat
    return float(np.percentile(image[where if where.any() else silhouette], 95.0))
