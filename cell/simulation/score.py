"""How well the simulated garment was folded, against what the plan wanted of it.

The only judge of a simulated run. It reads the world's truth (final vertices, flat rest shape), which
neither the executive nor any skill can see; it decides nothing and nothing waits for it.

The target is the plan applied to the world's true rest shape: the mesh is cut along the fold lines, so
that every triangle lies on one side of each, and folded as a perfect isometry. One rigid alignment in the
table plane (area-weighted least squares over corresponding triangles, no reflection, no scale: Kabsch 1976)
takes the final shape onto the target. All shape figures are taken after it; the alignment is the drift.

Lengths in metres, angles in radians, table frame.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from robots.errors import InternalError
from skills.garments.garment import Garment
from skills.planning.folding import fold_xy
from skills.planning.plan import plan_folds
from skills.vocabulary import Array, FoldLine, GarmentState, frozen

__all__ = [
    "Figure",
    "FinalGarment",
    "FoldedMesh",
    "Score",
    "ScoreLimits",
    "diagonal",
    "fold_mesh",
    "named_edge_pairs",
    "rasterise",
    "score",
    "score_plan",
    "ways_to_fold",
]

PIXEL = 0.001  # of the silhouette and height rasters [m]
EDGE_SPACING = 0.005  # between samples along a pair of edges [m]
ON_LINE = 1e-7  # a vertex this near a fold line lies on it: no slivers [m]
LARGEST_EXTENT = 5.0  # a garment wider than this has exploded: a bug of the world [m]


@dataclass(frozen=True, eq=False)
class FinalGarment:
    """The world's truth after a run.

    vertices: (n, 3) final positions, table frame. triangles: (m, 3). material: (n, 2) the flat rest shape
    in the pose in which it was laid, table frame. lines: the plan's fold lines in order, computed from the
    true key points of that rest shape. thickness: of one layer. edge_pairs: pairs of polylines
    (k, 2), (l, 2) in material coordinates whose corresponding points shall meet.
    """

    vertices: Array
    triangles: NDArray[np.int32]
    material: Array
    lines: tuple[FoldLine, ...]
    thickness: float
    edge_pairs: tuple[tuple[Array, Array], ...] = ()


@dataclass(frozen=True)
class ScoreLimits:
    """What passes. correspondence: as a fraction of the garment's diagonal; height: above the flat stack."""

    iou: float = 0.90
    correspondence: float = 0.025
    edges: float = 0.030
    height: float = 0.010
    drift: float = 0.050
    drift_angle: float = math.radians(10.0)
    crease_margin: float = 0.040
    """The height is not judged this near a fold line: cloth that nobody presses bulges there."""


DEFAULT_LIMITS = ScoreLimits()


@dataclass(frozen=True)
class Figure:
    """One figure and its threshold; `at_least`: larger is better."""

    value: float
    limit: float
    at_least: bool = False

    @property
    def passed(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True)
class Score:
    """The figures by name, each with its threshold, and the verdict. `layers`: of the flat target's stack."""

    figures: Mapping[str, Figure]
    layers: int

    @property
    def passed(self) -> bool:
        return all(f.passed for f in self.figures.values())

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the figures beyond their threshold."""
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
        """Plain values: `passed`, each figure, and `limits` with each threshold."""
        return {
            "passed": self.passed,
            **{name: f.value for name, f in self.figures.items()},
            "limits": {name: f.limit for name, f in self.figures.items()},
            "layers": self.layers,
        }


@dataclass(frozen=True, eq=False)
class FoldedMesh:
    """A mesh cut along the fold lines and folded flat.

    attributes: (n', k) of the cut mesh's vertices, interpolated from what was given. triangles: (m', 3).
    target: (n', 2) where the fold takes each vertex. area: (m',) of the triangles in the rest shape.
    creases: (c, 2, 2) end points of the creases' pieces where they lie in the target.
    """

    attributes: Array
    triangles: NDArray[np.int32]
    target: Array
    area: Array
    creases: Array


def score(garment: FinalGarment, limits: ScoreLimits = DEFAULT_LIMITS) -> Score:
    """Judge a folded garment. Raises InternalError when the world's state is not a garment (NaN, exploded)."""
    _check(garment)
    folded = fold_mesh(garment.material, garment.triangles, garment.lines, garment.vertices)
    final, corners = folded.attributes, folded.triangles
    centres, target_centres = final[corners, :2].mean(axis=1), folded.target[corners].mean(axis=1)
    align, drift, turn = _align(centres, target_centres, folded.area)
    error = np.linalg.norm(align(centres) - target_centres, axis=1)

    seen = np.column_stack([align(final[:, :2]), final[:, 2]])
    grid = _Grid.around(np.vstack([seen[:, :2], folded.target]))
    top, _ = grid.render(seen, corners)
    _, count = grid.render(np.column_stack([folded.target, np.zeros(len(seen))]), corners)
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
    """Judge a folded garment against its plan on its true key points, name -> (2,) material coordinates.

    A plan's step may be done in several ways (either half onto the other): the garment is judged by the way
    to which its final shape, where it lies, comes nearest.
    """
    pairs = named_edge_pairs(garment.edge_pairs, keypoints)
    finals = [
        FinalGarment(vertices, triangles, material, lines, thickness, pairs)
        for lines in ways_to_fold(garment, keypoints)
    ]
    return score(min(finals, key=_mean_distance), limits)


def ways_to_fold(garment: Garment, keypoints: Mapping[str, Array]) -> tuple[tuple[FoldLine, ...], ...]:
    """The fold lines of every way through the plan, the preferred one first."""
    outline = np.array([keypoints[name] for name in garment.keypoints])
    state = GarmentState(garment.category, outline, keypoints, confidence=1.0)
    choices = [[(step.name, v.name) for v in step.variants] for step in garment.plan]
    return tuple(plan_folds(state, garment, dict(way)).unwrap()[-1].lines for way in itertools.product(*choices))


def _mean_distance(garment: FinalGarment) -> float:
    target = fold_xy(garment.lines, garment.material)
    return float(np.linalg.norm(garment.vertices[:, :2] - target, axis=1).mean())


def fold_mesh(
    material: Array, triangles: NDArray[np.int32], lines: Sequence[FoldLine], attributes: Array
) -> FoldedMesh:
    """Cut a flat mesh (n, 2) along fold lines and fold it; `attributes` (n, k) are interpolated along.

    Each line is stated where the garment lies at that step, so a later line also cuts through what an
    earlier one has laid over.
    """
    rest_and_more = np.column_stack([material, attributes])
    y = np.array(material, dtype=float)
    corners = np.array(triangles, dtype=np.int32)
    crease_edges: list[NDArray[np.int64]] = []
    for line in lines:
        columns = np.column_stack([rest_and_more, y])
        columns, corners = _cut(columns, corners, line)
        rest_and_more, y = columns[:, :-2], columns[:, -2:]
        distance = _distance(line, y)
        y = np.where((distance > 0.0)[:, None], line.reflect(y), y)
    # Edges are looked up in the finished mesh: later lines have cut earlier creases too.
    before = rest_and_more[:, :2]
    for line in lines:
        distance = _distance(line, before)
        crease_edges.append(_creases(corners, distance))
        before = np.where((distance > 0.0)[:, None], line.reflect(before), before)
    edges = np.concatenate(crease_edges) if crease_edges else np.empty((0, 2), dtype=np.int64)
    return FoldedMesh(
        frozen(rest_and_more[:, 2:]),
        frozen(corners),
        frozen(y),
        frozen(np.abs(_doubled_area(rest_and_more[:, :2], corners)) / 2.0),
        frozen(y[edges]),
    )


def named_edge_pairs(
    pairs: Sequence[tuple[Sequence[str], Sequence[str]]], keypoints: Mapping[str, Array]
) -> tuple[tuple[Array, Array], ...]:
    """Edge pairs as a garment file names them, as polylines between the garment's true key points."""
    return tuple(
        (np.array([keypoints[n] for n in a], dtype=float), np.array([keypoints[n] for n in b], dtype=float))
        for a, b in pairs
    )


def diagonal(material: Array) -> float:
    """Largest distance between two points of the rest shape (n, 2): a rectangle's diagonal, in any pose."""
    return float(pdist(material[ConvexHull(material).vertices]).max())


def _check(garment: FinalGarment) -> None:
    x = garment.vertices
    bad = int((~np.isfinite(x)).any(axis=1).sum())
    if bad:
        raise InternalError("the world's garment has vertices that are no numbers", vertices=bad)
    extent = float(np.ptp(x, axis=0).max())
    if extent > LARGEST_EXTENT:
        raise InternalError("the world's garment has exploded", extent_m=extent, largest_m=LARGEST_EXTENT)


# --- cutting and folding -------------------------------------------------------------------------------


def _distance(line: FoldLine, xy: Array) -> Array:
    d = line.signed_distance(xy)
    return np.where(np.abs(d) < ON_LINE, 0.0, d)


def _cut(columns: Array, triangles: NDArray[np.int32], line: FoldLine) -> tuple[Array, NDArray[np.int32]]:
    """Split the triangles that `line` crosses; the last two columns say where the vertices lie."""
    d = _distance(line, columns[:, -2:])
    side = np.sign(d[triangles])
    crossed = (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    if not crossed.any():
        return columns, triangles
    vertices: list[Array] = []
    on_edge: dict[tuple[int, int], int] = {}

    def crossing(i: int, j: int) -> int:
        key = (min(i, j), max(i, j))
        if key not in on_edge:
            on_edge[key] = len(columns) + len(vertices)
            a, b = key
            u = d[a] / (d[a] - d[b])
            vertices.append((1.0 - u) * columns[a] + u * columns[b])
        return on_edge[key]

    pieces: list[tuple[int, int, int]] = []
    for triangle in triangles[crossed]:
        polygons: dict[float, list[int]] = {-1.0: [], 1.0: []}
        for i, j in zip(triangle, np.roll(triangle, -1), strict=True):
            i, j = int(i), int(j)
            for sign, polygon in polygons.items():
                if d[i] * sign >= 0.0:
                    polygon.append(i)
                if d[i] * d[j] < 0.0:
                    polygon.append(crossing(i, j))
        for polygon in polygons.values():
            pieces += [(polygon[0], polygon[k], polygon[k + 1]) for k in range(1, len(polygon) - 1)]
    return (
        np.vstack([columns, vertices]),
        np.vstack([triangles[~crossed], np.array(pieces, dtype=np.int32)]),
    )


def _creases(triangles: NDArray[np.int32], distance: Array) -> NDArray[np.int64]:
    """(c, 2) edges on a fold line with cloth that moves on one side and cloth that stays on the other."""
    side = np.sign(distance[triangles].sum(axis=1))
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1)
    on_line = (distance[edges] == 0.0).all(axis=1)
    owner = np.repeat(side, 3)
    moving = {tuple(e) for e in edges[on_line & (owner > 0)]}
    staying = {tuple(e) for e in edges[on_line & (owner < 0)]}
    return np.array(sorted(moving & staying), dtype=np.int64).reshape(-1, 2)


def _doubled_area(xy: Array, triangles: NDArray[np.int32]) -> Array:
    a, b = xy[triangles[:, 1]] - xy[triangles[:, 0]], xy[triangles[:, 2]] - xy[triangles[:, 0]]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


# --- alignment and edges -------------------------------------------------------------------------------


class _Align:
    """p -> R (p - from) + to, in the plane."""

    def __init__(self, source: Array, target: Array, angle: float) -> None:
        c, s = math.cos(angle), math.sin(angle)
        self.source, self.target, self.rotation = source, target, np.array([[c, -s], [s, c]])

    def __call__(self, xy: Array) -> Array:
        return (xy - self.source) @ self.rotation.T + self.target


def _align(xy: Array, target: Array, weight: Array) -> tuple[_Align, Array, float]:
    """The rigid motion onto the target; how far the centroid drifted (2,) and how far the shape turned."""
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
    """n points evenly along a polyline."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(polyline, axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], n)
    return np.column_stack([np.interp(at, s, polyline[:, 0]), np.interp(at, s, polyline[:, 1])])


def _where_now(garment: FinalGarment, material: Array) -> Array:
    """(k, 2) material points -> (k, 2) where they lie now; a point off the cloth counts as its nearest one.

    True outlines round the corners at which the key points stand, so points just off the cloth are usual.
    """
    return np.array([_interpolate(garment, p) for p in material])


def _interpolate(garment: FinalGarment, p: Array) -> Array:
    triangles, rest, now = garment.triangles, garment.material, garment.vertices[:, :2]
    a, b, c = (rest[triangles[:, k]] for k in range(3))
    area = _doubled_area(rest, triangles)
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


# --- seen from above -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Grid:
    """A raster over the table: pixel (row, column) has its centre at origin + PIXEL * (column, row)."""

    origin: Array
    shape: tuple[int, int]

    @classmethod
    def around(cls, xy: Array) -> _Grid:
        low, high = xy.min(axis=0), xy.max(axis=0)
        columns, rows = np.ceil((high - low) / PIXEL).astype(int) + 3
        # Half a pixel off: cloth edges that run along the axes do not fall onto pixel centres.
        return cls(low - 0.5 * PIXEL, (int(rows), int(columns)))

    def pixels(self, xy: Array) -> Array:
        return (xy - self.origin) / PIXEL

    def render(self, xyz: Array, triangles: NDArray[np.int32]) -> tuple[Array, NDArray[np.int32]]:
        """At each pixel: height of the upper surface (-inf where there is none), number of triangles."""
        return rasterise(self.pixels(xyz[:, :2]), xyz[:, 2].copy(), triangles, *self.shape)

    def away_from(self, segments: Array, margin: float) -> NDArray[np.bool_]:
        """Pixels further than `margin` from every segment (c, 2, 2)."""
        free = np.ones(self.shape, dtype=np.uint8)
        ends = np.rint(self.pixels(segments)).astype(np.int32)
        cv2.polylines(free, [*ends], False, (0.0,))
        if free.all():
            return free.astype(bool)
        return cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * PIXEL > margin


def _percentile(image: NDArray[Any], silhouette: NDArray[np.bool_], flat: NDArray[np.bool_]) -> float:
    """95th percentile over the silhouette away from the creases; over all of it when nothing lies away."""
    where = silhouette & flat
    return float(np.percentile(image[where if where.any() else silhouette], 95.0))


@numba.njit(cache=True, nogil=True)
def rasterise(
    xy: Array, z: Array, triangles: NDArray[np.int32], rows: int, columns: int
) -> tuple[Array, NDArray[np.int32]]:
    """Highest z and number of triangles at each pixel centre; xy in pixels. A shared edge is one triangle's."""
    top = np.full((rows, columns), -np.inf)
    count = np.zeros((rows, columns), dtype=np.int32)
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        area = (xy[j, 0] - xy[i, 0]) * (xy[k, 1] - xy[i, 1]) - (xy[j, 1] - xy[i, 1]) * (xy[k, 0] - xy[i, 0])
        if area == 0.0:
            continue
        if area < 0.0:
            j, k, area = k, j, -area
        left = max(0, int(np.ceil(min(xy[i, 0], xy[j, 0], xy[k, 0]))))
        right = min(columns - 1, int(np.floor(max(xy[i, 0], xy[j, 0], xy[k, 0]))))
        low = max(0, int(np.ceil(min(xy[i, 1], xy[j, 1], xy[k, 1]))))
        high = min(rows - 1, int(np.floor(max(xy[i, 1], xy[j, 1], xy[k, 1]))))
        for r in range(low, high + 1):
            for c in range(left, right + 1):
                wi = _edge(xy, j, k, c, r)
                wj = _edge(xy, k, i, c, r)
                wk = _edge(xy, i, j, c, r)
                if not (_covers(wi, xy, j, k) and _covers(wj, xy, k, i) and _covers(wk, xy, i, j)):
                    continue
                count[r, c] += 1
                height = (wi * z[i] + wj * z[j] + wk * z[k]) / area
                if height > top[r, c]:
                    top[r, c] = height
    return top, count


@numba.njit(cache=True, nogil=True, inline="always")
def _edge(xy: Array, a: int, b: int, x: float, y: float) -> float:
    return (xy[b, 0] - xy[a, 0]) * (y - xy[a, 1]) - (xy[b, 1] - xy[a, 1]) * (x - xy[a, 0])


@numba.njit(cache=True, nogil=True, inline="always")
def _covers(w: float, xy: Array, a: int, b: int) -> bool:
    """A pixel on an edge belongs to the triangle on one side of it only (the rule of rasterisers)."""
    if w != 0.0:
        return w > 0.0
    dx, dy = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
    return dy > 0.0 or (dy == 0.0 and dx < 0.0)
