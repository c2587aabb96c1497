"""The final garment of a run, and where its points lie after the alignment with the target.

One rigid alignment in the table plane (area-weighted least squares over corresponding triangles, no reflection, no
scale: Kabsch 1976) moves the final shape onto the target. The alignment itself is the drift.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.errors import InternalError
from foldcell.skills.fold_figures.folded_mesh import FoldedMesh, doubled_area
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.plane import cross, lengths_along, resampled, rotation
from foldcell.skills.scoring.verdict import IdealHeights
from foldcell.skills.vocabulary import Array, FoldLine

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


class AlignedGarment:
    """A final garment, moved onto its target. error: (m,) distances of the barycentres of the cut mesh's triangles
    from their places in the target [m]; drift: displacement (2,) of the centroid from its place in the target [m];
    turn: rotation of the shape against the target [rad].

    folded: the garment's mesh, cut at the fold lines, with its final vertices as attributes. Raises InternalError
    if these vertices are not finite or too far apart.
    """

    def __init__(self, garment: FinalGarment, folded: FoldedMesh) -> None:
        _check(garment)
        self._garment = garment
        xy = folded.attributes[folded.triangles, :2].mean(axis=1)
        target = folded.target[folded.triangles].mean(axis=1)
        self._source, self._target = (np.average(points, axis=0, weights=folded.area) for points in (xy, target))
        p, q = xy - self._source, target - self._target
        angle = math.atan2(float(folded.area @ cross(p, q)), float(folded.area @ (p * q).sum(axis=1)))
        self._rotation = rotation(angle)
        self.drift, self.turn = self._source - self._target, -angle
        self.error = np.linalg.norm(self.moved(xy) - target, axis=1)

    def moved(self, xy: Array) -> Array:
        """Return points (n, 2) as the alignment moves them."""
        return (xy - self._source) @ self._rotation.T + self._target

    def largest_edge_distance(self) -> float:
        """Return the largest distance between corresponding points of a pair of edges [m]; 0 without pairs."""
        largest = 0.0
        for pair in self._garment.edge_pairs:
            n = 1 + math.ceil(max(float(lengths_along(edge)[-1]) for edge in pair) / EDGE_SPACING)
            a, b = (self._now(resampled(edge, n)) for edge in pair)
            largest = max(largest, float(np.linalg.norm(a - b, axis=1).max()))
        return largest

    def keypoint_offsets(self) -> dict[str, Array]:
        """Return, for each key point, the vector (2,) from its place in the target to where it is now [m]."""
        if not self._garment.keypoints:
            return {}
        points = np.array(list(self._garment.keypoints.values()), dtype=float)
        offsets = self._now(points) - fold_xy(self._garment.lines, points)
        return dict(zip(self._garment.keypoints, offsets, strict=True))

    def _now(self, material: Array) -> Array:
        """Return the aligned positions (k, 2) of material points (k, 2). A point beside the cloth is replaced by
        the nearest point of the cloth, because true outlines have round corners and key points are often just
        beside the cloth."""
        return self.moved(np.array([_interpolate(self._garment, p) for p in material]))


def _check(garment: FinalGarment) -> None:
    x = garment.vertices
    bad = int((~np.isfinite(x)).any(axis=1).sum())
    if bad:
        raise InternalError("the world's garment has vertices that are not finite", vertices=bad)
    extent = float(np.ptp(x, axis=0).max())
    if extent > LARGEST_EXTENT:
        raise InternalError("the world's garment has exploded", extent_m=extent, largest_m=LARGEST_EXTENT)


def _interpolate(garment: FinalGarment, p: Array) -> Array:
    triangles, rest, now = garment.triangles, garment.material, garment.vertices[:, :2]
    a, b, c = (rest[triangles[:, k]] for k in range(3))
    area = doubled_area(rest, triangles)
    w = np.column_stack([cross(b - p, c - p), cross(c - p, a - p), cross(a - p, b - p)]) / area[:, None]
    inside = np.flatnonzero(w.min(axis=1) >= -1e-9)
    if len(inside):
        return w[inside[0]] @ now[triangles[inside[0]]]
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    start, along = rest[edges[:, 0]], rest[edges[:, 1]] - rest[edges[:, 0]]
    u = np.clip(((p - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    k = int(np.linalg.norm(start + u[:, None] * along - p, axis=1).argmin())
    i, j = edges[k]
    return (1.0 - u[k]) * now[i] + u[k] * now[j]
