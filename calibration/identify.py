"""Identify the friction of a garment on the table from a fold: compare the observed outline with predictions for
candidate frictions.

A fold that drags the resting part of the cloth over the table reveals the table's friction. A fold that drags
nothing shows only that the friction was sufficient. If the outline contains no information, the estimate equals
the prior.

Accuracy (tested on folds simulated with another mesh): if cloth was dragged, the estimate moves from the prior
towards the true value; if not, it stays at the prior. The size of the change is less accurate. Frictions of 0.65,
0.8 and 1.2 times the assumed friction were estimated as 0.70, 0.83 and 1.49 times, because the friction at which
dragging begins depends on the mesh. The standard deviations are valid under the assumed errors; they are not
validated confidence bounds.

Method: Bayes on a grid. The signed distances of the observed outline from the predicted outlines are interpolated
between the candidates, linearly in the logarithm of the friction. A robust (Huber) likelihood weighs the
distances. Each correlation length of the outline counts as one independent point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.vocabulary import GraspId, Material, ToolPath

FRICTIONS = (0.5, 0.65, 0.8, 1.0, 1.25, 1.6)
"""Factors by which the assumed friction is multiplied to give the candidate frictions."""
BOUND = 0.5
"""Largest allowed relative difference between an updated friction and the friction of the garment file."""
POINTS = 240
"""Number of compared points along the observed outline."""
FINE = 81
"""Number of frictions of the fine grid, on which the estimate is computed."""
SIGMA = 0.004
"""Standard deviation of the distance between an observed outline and a correct prediction, due to camera and
simulation [m] (assumed)."""
CORRELATION = 0.50
"""Correlation length of this error along the outline [m] (assumed). It is long, because most of a simulation's
error is a drift of the whole outline."""
HUBER = 0.012
"""Distance above which the loss is linear [m] (assumed)."""
PRIOR = 0.30
"""Relative standard deviation of the prior (assumed)."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """friction: (f,) static coefficients, which increase. shapes: for each, the silhouette after the fold, a
    polygon in the table frame [m]."""

    friction: Array
    shapes: Sequence[shapely.Geometry]


@dataclass(frozen=True)
class FrictionEstimate:
    """friction: the estimated static coefficient. deviation: its standard deviation under the assumed errors.
    learned: relative reduction of the prior's variance by the outline (0: no information, 1: full information).
    misfit: rms distance of the outlines at the estimate [m]. A misfit of several sigma means that no candidate
    explains the observation; it increases the standard deviation."""

    friction: float
    deviation: float
    learned: float
    misfit: float

    def update_of(self, believed: Material, nominal: Material) -> Material:
        """Return `believed` with its friction moved towards the estimate. The logarithm of the friction moves by
        the fraction `learned` of its distance to the logarithm of the estimate. The result stays within BOUND of
        the friction of `nominal`."""
        before, lowest = believed.friction_static, (1.0 - BOUND) * nominal.friction_static
        moved = before * (self.friction / before) ** self.learned
        return believed.with_friction(float(np.clip(moved, lowest, (1.0 + BOUND) * nominal.friction_static)))


def silhouette(vertices: Array, triangles: NDArray[np.int32]) -> shapely.Geometry:
    """Return the outline of a mesh as seen from above. vertices: (n, 3); triangles: (m, 3)."""
    flat = shapely.polygons(np.asarray(vertices)[triangles][:, :, :2])
    return shapely.union_all(shapely.buffer(flat, 1e-5))


def outline_residual(contour: Array, vertices: Array, triangles: NDArray[np.int32]) -> float:
    """Return the root mean square distance [m] of an observed outline (k, 2) from the outline of a predicted shape
    with vertices (n, 3)."""
    distances = _distances(shapely.LinearRing(contour), silhouette(vertices, triangles))
    return float(np.sqrt(np.mean(distances**2)))


def predict_candidates(
    mesh: ClothMesh,
    positions: Array,
    material: Material,
    paths: Mapping[GraspId, ToolPath],
    factors: Sequence[float] = FRICTIONS,
    seen_as: Callable[[Array], Array] = np.asarray,
    pads: PadGeometry | None = None,
) -> Candidates:
    """Simulate the fold from `positions` (n, 3) for each factor of the friction of `material`.

    seen_as: maps vertices (n, 3) to their apparent positions (n, 3) in the camera; default: a view from straight
    above. pads: of the hands; None: the default pads.
    """
    friction = material.friction_static * np.sort(factors)
    ends = (predict_fold(mesh, positions, material.with_friction(float(mu)), paths, pads=pads) for mu in friction)
    return Candidates(friction, [silhouette(seen_as(end.vertices), mesh.triangles) for end in ends])


def identify_friction(contour: Array, candidates: Candidates, believed: Material) -> FrictionEstimate:
    """Estimate the friction from an observed outline (k, 2) [m], table frame. believed: material at the centre of
    the prior."""
    ring = shapely.LinearRing(contour)
    distances = np.array([_distances(ring, shape) for shape in candidates.shapes])
    friction = np.geomspace(candidates.friction[0], candidates.friction[-1], FINE)
    axis = np.log(candidates.friction)
    d = RegularGridInterpolator((axis,), distances)(np.log(friction)[:, None].clip(axis[0], axis[-1]))
    misfit = float(np.sqrt((d**2).mean(axis=-1).min()))
    size = np.abs(d)
    loss = np.where(size <= HUBER, size**2, HUBER * (2.0 * size - HUBER)).mean(axis=-1)
    prior = -0.5 * (np.log(friction / believed.friction_static) / PRIOR) ** 2
    posterior = prior - 0.5 * max(ring.length / CORRELATION, 1.0) * loss / max(SIGMA, misfit) ** 2
    (_, before), (value, after) = (_moments(friction, density) for density in (prior, posterior))
    return FrictionEstimate(value, float(np.sqrt(after)), max(0.0, 1.0 - after / before), misfit)


def _distances(ring: shapely.LinearRing, shape: shapely.Geometry) -> Array:
    """Return the signed distances (POINTS,) of points on the observed outline from the predicted outline, positive
    outside [m]."""
    points = shapely.line_interpolate_point(ring, np.linspace(0.0, 1.0, POINTS, endpoint=False), normalized=True)
    distance = shapely.distance(shapely.boundary(shape), points)
    return np.asarray(np.where(shapely.contains(shape, points), -distance, distance))


def _moments(values: Array, log_density: Array) -> tuple[float, float]:
    """Return mean and variance of values (n,) with a density (n,)."""
    w = np.exp(log_density - log_density.max())
    w /= w.sum()
    mean = float(w @ values)
    return mean, float(w @ (values - mean) ** 2)
