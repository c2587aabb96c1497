"""The score of a simulated run: a comparison of the final garment with the target of its plan.

The scorer reads the world's truth (final vertices, flat rest shape), which neither the executive nor any skill can
see. Its result affects no decision of a run.

The target is the plan applied to the world's true rest shape. The mesh is cut along the fold lines, so that every
triangle lies on one side of each line, and is folded as a perfect isometry. One rigid alignment in the table plane
(area-weighted least squares over corresponding triangles, no reflection, no scale: Kabsch 1976) moves the final
shape onto the target. All shape figures are computed after this alignment. The alignment itself is the drift.

There are two verdicts. `shape` concerns the figures seen from above, `flat` the heights. How high unpressed cloth
stands depends on its fabric, so the heights are compared with those of an ideal fold of the same garment
(`ideal.py`): nothing that does not press can be asked for more.

Lengths in metres, angles in radians, table frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from robots.errors import InternalError
from skills.fold_figures.fold_figures import CREASE_MARGIN, measure_cut_fold
from skills.fold_figures.folded_mesh import FoldedMesh, doubled_area, fold_mesh
from skills.fold_plan.folding import fold_xy
from skills.fold_plan.plan import ways_to_fold
from skills.garments.garment import Garment
from skills.vocabulary import Array, FoldLine

__all__ = [
    "Figure",
    "FinalGarment",
    "IdealHeights",
    "Score",
    "ScoreLimits",
    "diagonal",
    "keypoint_offsets",
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
    corresponding points of a pair should meet. keypoints: name -> (2,) true key points in material coordinates.
    ideal: heights of the ideal fold; None if the heights are not judged.
    """

    vertices: Array
    triangles: NDArray[np.int32]
    material: Array
    lines: tuple[FoldLine, ...]
    thickness: float
    edge_pairs: tuple[tuple[Array, Array], ...] = ()
    keypoints: Mapping[str, Array] = field(default_factory=dict)
    ideal: IdealHeights | None = None


@dataclass(frozen=True)
class IdealHeights:
    """Heights of an ideal fold [m], measured as those of the garment, and figures that show whether this fold can
    serve as the ideal.

    flaw: why it cannot, in words; None if it can. crossings: number of places where layers pass through each
    other; strain: largest strain of an edge away from creases, as a fraction; motion: largest displacement of a
    vertex in the last 0.1 s [m]; iou: overlap with the target. NaN: not known, because the fold cannot be made.
    """

    height: float
    crease_height: float
    flaw: str | None = None
    crossings: int = 0
    strain: float = 0.0
    motion: float = 0.0
    iou: float = 1.0

    def to_json(self) -> dict[str, Any]:
        """Plain values: `valid`, the `reason` if it is not, and the figures; null for an unknown figure."""
        figures = {"strain": self.strain, "motion_m": self.motion, "iou": self.iou}
        return {
            "valid": self.flaw is None,
            "reason": self.flaw,
            "crossings": self.crossings,
            **{name: _known(value) for name, value in figures.items()},
        }


@dataclass(frozen=True)
class ScoreLimits:
    """Limits of the figures for a pass. correspondence: fraction of the garment's diagonal; height: above the flat
    stack, ideal_height, ideal_crease_height: above those of the ideal fold [m]; edges, keypoints, drift [m];
    drift_angle [rad]."""

    iou: float = 0.90
    correspondence: float = 0.025
    edges: float = 0.030
    keypoints: float = 0.030
    height: float = 0.010
    ideal_height: float = 0.003
    ideal_crease_height: float = 0.010
    drift: float = 0.050
    drift_angle: float = math.radians(10.0)
    crease_margin: float = CREASE_MARGIN
    """Distance from a fold line within which unpressed cloth bulges, so that its height is judged separately
    [m]."""


DEFAULT_LIMITS = ScoreLimits()
HEIGHTS = ("height_m", "crease_height_m")
"""Names of the figures of the verdict `flat`."""


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
    """The figures by name, and the verdicts. layers: number of layers in the stack of the flat target; stack: its
    height [m]. lines: the fold lines of the target. ideal: None if the heights are not judged."""

    figures: Mapping[str, Figure]
    layers: int
    stack: float = 0.0
    lines: tuple[FoldLine, ...] = ()
    ideal: IdealHeights | None = None

    def with_ideal(self, ideal: IdealHeights, limits: ScoreLimits = DEFAULT_LIMITS) -> Score:
        """Return the score with the heights judged against those of the ideal fold about the same lines."""
        limit = {
            "height_m": max(self.stack + limits.height, ideal.height + limits.ideal_height),
            "crease_height_m": ideal.crease_height + limits.ideal_crease_height,
        }
        judged = {name: replace(self.figures[name], limit=limit[name]) for name in HEIGHTS}
        return replace(self, figures={**self.figures, **judged}, ideal=ideal)

    @property
    def shape(self) -> bool:
        return all(f.passed for name, f in self.figures.items() if name not in HEIGHTS)

    @property
    def flat(self) -> bool | None:
        """Whether the heights pass; None if they are not judged or if the ideal fold has a flaw."""
        if self.ideal is None or self.ideal.flaw is not None:
            return None
        return all(self.figures[name].passed for name in HEIGHTS)

    @property
    def passed(self) -> bool:
        """Shape and flat. A run whose ideal fold has a flaw has not passed."""
        return self.shape and (self.ideal is None or self.flat is True)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the figures that do not pass their limit."""
        return tuple(name for name, f in self._judged.items() if not f.passed)

    @property
    def _judged(self) -> dict[str, Figure]:
        return {n: f for n, f in self.figures.items() if self.flat is not None or n not in HEIGHTS}

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
        """Plain values: the verdicts `passed`, `shape` and `flat`, each figure, `limits` with the limit of each
        judged figure, the heights of the ideal fold, its validity (`ideal`), and `layers`."""
        ideal = self.ideal
        return {
            "passed": self.passed,
            "shape": self.shape,
            "flat": self.flat,
            **{name: f.value for name, f in self.figures.items()},
            "ideal_height_m": None if ideal is None else _known(ideal.height),
            "ideal_crease_height_m": None if ideal is None else _known(ideal.crease_height),
            "ideal": None if ideal is None else ideal.to_json(),
            "limits": {name: f.limit for name, f in self._judged.items()},
            "layers": self.layers,
        }


def score(garment: FinalGarment, limits: ScoreLimits = DEFAULT_LIMITS) -> Score:
    """Score a folded garment. Raises InternalError if its vertices are not finite or too far apart."""
    _check(garment)
    folded = fold_mesh(garment.material, garment.triangles, garment.lines, garment.vertices)
    final = folded.attributes
    centres, target_centres = _centres(folded)
    align, drift, turn = _align(centres, target_centres, folded.area)
    error = np.linalg.norm(align(centres) - target_centres, axis=1)

    aligned = np.column_stack([align(final[:, :2]), final[:, 2]])
    seen = measure_cut_fold(folded, aligned, limits.crease_margin)
    stack = seen.layers * garment.thickness

    figures = {
        "iou": Figure(seen.iou, limits.iou, at_least=True),
        "correspondence_m": Figure(
            float(np.average(error, weights=folded.area)), limits.correspondence * diagonal(garment.material)
        ),
        "edges_m": Figure(_largest_edge_distance(garment, align), limits.edges),
        "keypoints_m": Figure(_largest_keypoint_distance(garment, align), limits.keypoints),
        "height_m": Figure(seen.height, math.inf),  # the limits of the heights depend on the ideal fold
        "crease_height_m": Figure(seen.crease_height, math.inf),
        "drift_m": Figure(float(np.linalg.norm(drift)), limits.drift),
        "drift_rad": Figure(abs(turn), limits.drift_angle),
    }
    found = Score(figures, round(seen.layers), stack, tuple(garment.lines))
    return found if garment.ideal is None else found.with_ideal(garment.ideal, limits)


def keypoint_offsets(garment: FinalGarment) -> dict[str, Array]:
    """Return, for each key point, the vector (2,) from its place in the target to where it is now [m], with the
    garment aligned as for its score. Raises InternalError like `score`."""
    _check(garment)
    folded = fold_mesh(garment.material, garment.triangles, garment.lines, garment.vertices)
    align, _, _ = _align(*_centres(folded), folded.area)
    return _offsets(garment, align)


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
    The heights are not judged yet (`Score.with_ideal`).

    A step of a plan may have several variants (either half onto the other). The garment is scored against the
    combination of variants whose target is nearest to its final shape, measured without alignment. Raises
    InternalError like `score`.
    """
    pairs = named_edge_pairs(garment.edge_pairs, keypoints)
    finals = [
        FinalGarment(vertices, triangles, material, lines, thickness, pairs, keypoints)
        for lines in ways_to_fold(garment, keypoints)
    ]
    return score(min(finals, key=_mean_distance), limits)


def _known(figure: float) -> float | None:
    return figure if math.isfinite(figure) else None


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


def _centres(folded: FoldedMesh) -> tuple[Array, Array]:
    """Return the barycentres (m, 2) of the triangles as they lie, and in the target."""
    corners = folded.triangles
    return folded.attributes[corners, :2].mean(axis=1), folded.target[corners].mean(axis=1)


def _largest_keypoint_distance(garment: FinalGarment, align: _Align) -> float:
    return max((float(np.linalg.norm(off)) for off in _offsets(garment, align).values()), default=0.0)


def _offsets(garment: FinalGarment, align: _Align) -> dict[str, Array]:
    if not garment.keypoints:
        return {}
    points = np.array(list(garment.keypoints.values()), dtype=float)
    now, wanted = align(_where_now(garment, points)), fold_xy(garment.lines, points)
    return dict(zip(garment.keypoints, now - wanted, strict=True))


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
