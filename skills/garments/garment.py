"""Data of a garment that are known before it is seen: template, fabric, fold plan, and the poses in which it may
lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foldcell.skills.vocabulary import Array, GarmentState, GraspId, Material, frozen

Edge = tuple[str, str]
Span = tuple[float, float]
"""Smallest and largest value."""


@dataclass(frozen=True)
class Fabric:
    """A class of fabrics, as in fabrics.yaml.

    Each property has the range of the class and the source of the range: areal_mass [kg/m2]; bending_length:
    Peirce's, of the geometric mean of the rigidities along warp and weft [m]; bending_ratio: rigidity along the
    warp divided by that along the weft [1]; thickness: distance that one layer keeps to the next [m];
    friction_layers: coefficient between layers [1].
    """

    name: str
    title: str
    areal_mass: Span
    bending_length: Span
    bending_ratio: Span
    thickness: Span
    friction_layers: Span
    sources: Mapping[str, str]


@dataclass(frozen=True)
class Anchor:
    """A point of the garment, given as a weighted mean of key points: their names and weights, which sum to one.

    The point is defined on the flat garment, so folds that bring key points together do not change it.
    """

    weights: tuple[tuple[str, float], ...]

    def on(self, keypoints: Mapping[str, Array]) -> Array:
        """Return the position (2,) of the point, given the positions of the key points, name -> (2,)."""
        return np.asarray(sum(w * np.asarray(keypoints[name]) for name, w in self.weights))


@dataclass(frozen=True)
class PlanGrasp:
    """One grasp of a step. at: the point of the garment's edge from which the grasp is measured.

    inset: distances from `at` to the grasp [m]: perpendicular to the fold line, towards it, and parallel to the
    line, towards the middle of the moving part. grasp_id: None if the garment's pose determines the id. turn:
    angle between the held line (the strip of cloth between the pads) and the fold line [rad].
    """

    at: Anchor
    inset: tuple[float, float]
    grasp_id: GraspId | None = None
    turn: float = 0.0


@dataclass(frozen=True)
class PlanVariant:
    """An alternative plan for a fold: the key points on its moving side, and the grasps."""

    name: str
    moves: tuple[str, ...]
    grasps: tuple[PlanGrasp, ...]


@dataclass(frozen=True)
class PlanStep:
    """One fold. line: two anchors on the flat garment.

    variants: in order of preference; they differ in the moving side (the fold's direction) and in the grasps.
    tension: (past, apart) [m]. A grasp is released `past` beyond its mirror image in the fold line, farther from
    the line. If two hands fold, each also moves outwards by `apart`, parallel to the line, during the fold.
    Tension takes up the slack that results from cloth sagging between the hands and from the unpressed crease.
    """

    name: str
    line: tuple[Anchor, Anchor]
    variants: tuple[PlanVariant, ...]
    tension: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class PoseRange:
    """Ranges of the garment's centre [m] and angle [rad], table frame: (low, high) each."""

    x: tuple[float, float]
    y: tuple[float, float]
    angle: tuple[float, float]

    @property
    def middle(self) -> tuple[float, float, float]:
        """Centre and angle in the middle of the ranges."""
        return sum(self.x) / 2, sum(self.y) / 2, sum(self.angle) / 2

    def sample(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Draw x, y [m] and angle [rad] uniformly from the ranges."""
        x, y, angle = (float(rng.uniform(*r)) for r in (self.x, self.y, self.angle))
        return x, y, angle

    def contains(self, x: float, y: float, angle: float) -> bool:
        pairs = zip((x, y, angle), (self.x, self.y, self.angle), strict=True)
        return all(low <= v <= high for v, (low, high) in pairs)


@dataclass(frozen=True, eq=False)
class Garment:
    """A garment as its file describes it, on one surface.

    keypoints: names in counter-clockwise order; template: (k, 2) [m] their positions at nominal size, centred on 0
    and rotated as the garment is laid, so that pose (x, y, 0) is a translation. layers: number of layers of the
    flat garment. edge_pairs: pairs of edges that coincide after the last fold. An edge is given by two key points;
    the first key points of the two edges coincide, and so do the second ones. size_range: smallest and largest
    factor on the nominal size for which the plan is valid. max_tool_speed [m/s]: limit that the cloth requires.
    final_layers: maximum number of layers after the last fold. fabric: class of its fabric, None if it is not
    stated.
    """

    name: str
    title: str
    category: str
    layers: int
    keypoints: tuple[str, ...]
    template: Array
    material: Material
    plan: tuple[PlanStep, ...]
    edge_pairs: tuple[tuple[Edge, Edge], ...]
    max_tool_speed: float
    poses: PoseRange
    size_range: tuple[float, float]
    final_layers: int
    surface: str
    fabric: Fabric | None = None

    @property
    def size_m(self) -> tuple[float, float]:
        """Nominal extent along x and y as laid [m]."""
        dx, dy = np.ptp(self.template, axis=0)
        return float(dx), float(dy)

    @property
    def mesh_edge_m(self) -> float:
        """Edge length of the meshes that predict the garment's folds [m]. Coarser meshes cannot be folded
        twice."""
        return float(np.clip(min(self.size_m) / 20.0, 0.014, 0.026))

    @property
    def bending_factors(self) -> tuple[float, float]:
        """Range of the bending length in the garment's class of fabrics, relative to the garment's own."""
        if self.fabric is None:
            return 0.85, 1.15
        low, high = self.fabric.bending_length
        return low / self.material.bending_length, high / self.material.bending_length

    def thickness_sigma(self, spread: float) -> float:
        """Standard deviation of one layer's thickness about the stated one [m]: of a uniform distribution over the
        garment's class of fabrics, or without a class the share `spread` of the stated thickness."""
        if self.fabric is None:
            return spread * self.material.thickness
        low, high = self.fabric.thickness
        return (high - low) / 12.0**0.5

    def thickness_of(self, measured: float | None) -> float:
        """Return the thickness of one layer [m] that follows from a measurement between the pads, or without one
        the stated thickness. A measurement outside the range of the fabric's class is taken as the nearest
        thickness of the class: the hands may have held a fold of the cloth."""
        if measured is None:
            return self.material.thickness
        return measured if self.fabric is None else float(np.clip(measured, *self.fabric.thickness))

    def place(self, x: float, y: float, angle: float = 0.0, scale: float = 1.0) -> Array:
        """Return the positions (k, 2) of the key points at a pose, table frame [m]."""
        c, s = np.cos(angle), np.sin(angle)
        return scale * self.template @ np.array([[c, s], [-s, c]]) + (x, y)

    def flat_state(self, x: float, y: float, angle: float = 0.0, scale: float = 1.0) -> GarmentState:
        """Return the state that a perfect perception would report for the flat garment at a pose."""
        points = self.place(x, y, angle, scale)
        named = {name: frozen(p) for name, p in zip(self.keypoints, points, strict=True)}
        return GarmentState(self.category, frozen(points), named, confidence=1.0)
