"""Identify friction and stretch from a fold by comparing observed silhouettes with predictions for candidate
materials.

A fold that drags the resting part of the cloth over the table reveals the table's friction. A fold that drags
nothing shows only that the friction was sufficient. The stretch of a garment moves its outline by a fraction of a
millimetre, which is less than a camera resolves. If the pictures contain no information, the estimate equals the
prior.

Accuracy (tested on folds simulated with another mesh): if cloth was dragged, the estimate moves from the prior
towards the true value; if not, it stays at the prior. The size of the change is less accurate. Frictions of 0.65,
0.8 and 1.2 times the assumed friction were estimated as 0.70, 0.83 and 1.49 times, because the friction at which
dragging begins depends on the mesh. The standard deviations are valid under the assumed `Noise`; they are not
validated confidence bounds.

Method: Bayes on a grid. The signed distances of the observed outline from the predicted outlines are interpolated
between the candidates, linearly in the logarithms of friction and stretch. A robust (Huber) likelihood weighs the
distances. Each correlation length of the outline counts as one independent point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from robots.errors import ConfigurationError
from robots.ports import Array
from skills.cloth.mesh import ClothMesh
from skills.cloth.pinch import PadGeometry
from skills.cloth.predict import predict_fold
from skills.vocabulary import GraspId, Material, ToolPath

__all__ = [
    "FRICTIONS",
    "Candidates",
    "MaterialEstimate",
    "Noise",
    "Quantity",
    "identify_material",
    "outline_residual",
    "predict_candidates",
    "silhouette",
]

FRICTIONS = (0.5, 0.65, 0.8, 1.0, 1.25, 1.6)
"""Factors by which the assumed friction is multiplied to give the candidate frictions."""
BOUND = 0.5
"""Largest allowed relative difference between an updated friction and the friction of the garment file."""
POINTS = 240
"""Number of compared points along each observed outline."""
FINE = 81
"""Number of points along each axis of the fine grid, on which the estimate is computed."""


@dataclass(frozen=True)
class Noise:
    """Error model of the observed outlines. sigma: standard deviation of the distance between an observed outline
    and a correct prediction (camera and simulation) [m]; correlation: correlation length of this error along the
    outline [m]; huber: distance above which the loss is linear [m]. friction, stretch: relative standard
    deviations of the prior."""

    # assumed values; the correlation is long, because most of a simulation's error is a drift of the whole outline
    sigma: float = 0.004
    correlation: float = 0.50
    huber: float = 0.012
    friction: float = 0.30
    stretch: float = 0.30


@dataclass(frozen=True, eq=False)
class Candidates:
    """The grid of candidate materials. friction (f,): static coefficients; stretch (s,): fractions; both increase.
    shapes[i][j][k]: silhouette (polygon, table frame [m]) in picture k, predicted with friction i and stretch
    j."""

    friction: Array
    stretch: Array
    shapes: Sequence[Sequence[Sequence[shapely.Geometry]]]


@dataclass(frozen=True)
class Quantity:
    """An estimated value and its standard deviation under the assumed `Noise`. learned: relative reduction of the
    prior's variance by the pictures (0: no information, 1: full information)."""

    value: float
    deviation: float
    learned: float


@dataclass(frozen=True)
class MaterialEstimate:
    """Estimates of friction and stretch. misfit: rms distance of the outlines at the estimate [m]. A misfit of
    several sigma means that no candidate explains the observation; it increases the standard deviations."""

    friction: Quantity
    stretch: Quantity
    misfit: float

    def update_of(self, believed: Material, nominal: Material) -> Material:
        """Return `believed` with its friction moved towards the estimate. The logarithm of the friction moves by
        the fraction `learned` of its distance to the logarithm of the estimate. The result stays within BOUND of
        the friction of `nominal`."""
        before, lowest = believed.friction_static, (1.0 - BOUND) * nominal.friction_static
        moved = before * (self.friction.value / before) ** self.friction.learned
        return believed.with_friction(float(np.clip(moved, lowest, (1.0 + BOUND) * nominal.friction_static)))


def silhouette(vertices: Array, triangles: NDArray[np.int32]) -> shapely.Geometry:
    """Return the outline of a mesh as seen from above. vertices: (n, 3); triangles: (m, 3)."""
    flat = shapely.polygons(np.asarray(vertices)[triangles][:, :, :2])
    return shapely.union_all(shapely.buffer(flat, 1e-5))


def outline_residual(contour: Array, vertices: Array, triangles: NDArray[np.int32]) -> float:
    """Return the root mean square distance [m] of an observed outline (k, 2) from the outline of a predicted shape
    with vertices (n, 3)."""
    ring = shapely.LinearRing(contour)
    return float(np.sqrt(np.mean(_distances([ring], [silhouette(vertices, triangles)]) ** 2)))


def predict_candidates(
    mesh: ClothMesh,
    positions: Array,
    material: Material,
    paths: Mapping[GraspId, ToolPath],
    friction_factors: Sequence[float] = FRICTIONS,
    stretch_factors: Sequence[float] = (1.0,),
    seen_as: Callable[[Array], Array] = np.asarray,
    pads: PadGeometry | None = None,
) -> Candidates:
    """Simulate the fold from `positions` (n, 3) for each combination of a friction factor and a stretch factor.
    The factors multiply the friction and the stretch of `material`.

    The number of simulations is len(friction_factors) * len(stretch_factors). Each candidate has one picture,
    taken at the end of the fold. seen_as: maps vertices (n, 3) to their apparent positions (n, 3) in the camera;
    default: a view from straight above. pads: of the hands; None: the default pads.
    """
    friction = material.friction_static * np.sort(friction_factors)
    stretch = material.stretch_fraction * np.sort(stretch_factors)
    shapes = []
    for mu in friction:
        fabric = material.with_friction(float(mu))
        row = []
        for s in stretch:
            end = predict_fold(mesh, positions, replace(fabric, stretch_fraction=float(s)), paths, pads=pads)
            row.append((silhouette(seen_as(end.vertices), mesh.triangles),))
        shapes.append(row)
    return Candidates(friction, stretch, shapes)


def identify_material(
    observed: Sequence[Array], candidates: Candidates, believed: Material, noise: Noise | None = None
) -> MaterialEstimate:
    """Estimate friction and stretch from the observed outlines.

    observed: one contour (k, 2) [m] for each picture, table frame, in the order of the candidates' pictures.
    believed: material at the centre of the prior. Raises ConfigurationError for inconsistent contours or
    candidates.
    """
    noise = noise or Noise()
    _check(observed, candidates)
    rings = [shapely.LinearRing(contour) for contour in observed]
    distances = np.array([[_distances(rings, shapes) for shapes in row] for row in candidates.shapes])
    independent = sum(max(ring.length / noise.correlation, 1.0) for ring in rings)
    friction = _fine(candidates.friction)
    stretch = _fine(candidates.stretch)
    squared, loss = _interpolated(distances, candidates, friction, stretch, noise.huber)
    misfit = float(np.sqrt(squared.min()))
    sigma = max(noise.sigma, misfit)
    prior_f = -0.5 * (np.log(friction / believed.friction_static) / noise.friction) ** 2
    prior_s = -0.5 * (np.log(stretch / believed.stretch_fraction) / noise.stretch) ** 2
    prior = prior_f[:, None] + prior_s[None, :]
    posterior = prior - 0.5 * independent * loss / sigma**2
    before, after = _weights(prior), _weights(posterior)
    return MaterialEstimate(
        _quantity(friction, before.sum(axis=1), after.sum(axis=1)),
        _quantity(stretch, before.sum(axis=0), after.sum(axis=0)),
        misfit,
    )


def _check(observed: Sequence[Array], candidates: Candidates) -> None:
    for name, axis in (("friction", candidates.friction), ("stretch", candidates.stretch)):
        if not len(axis) or (np.diff(axis) <= 0).any() or not (axis > 0).all():
            raise ConfigurationError(f"candidates of {name} must be positive and increase", "", values=list(axis))
    if len(candidates.friction) < 2:
        raise ConfigurationError("give at least two candidate frictions", "", values=list(candidates.friction))
    if not observed or any(len(k) != len(observed) for row in candidates.shapes for k in row):
        raise ConfigurationError("each candidate needs one silhouette for each observed picture", "")
    for k, contour in enumerate(observed):
        c = np.asarray(contour, dtype=float)
        if c.ndim != 2 or c.shape[1] != 2 or len(c) < 3 or not np.isfinite(c).all():
            raise ConfigurationError("an observed contour must be (k, 2) and finite", "", picture=k, shape=c.shape)


def _distances(rings: Sequence[shapely.LinearRing], shapes: Sequence[shapely.Geometry]) -> Array:
    """Return the signed distances (pictures * POINTS,) of points on the observed outlines from the predicted
    outlines, positive outside [m]."""
    out = []
    for ring, shape in zip(rings, shapes, strict=True):
        points = shapely.line_interpolate_point(
            ring, np.linspace(0.0, 1.0, POINTS, endpoint=False), normalized=True
        )
        distance = shapely.distance(shapely.boundary(shape), points)
        out.append(np.where(shapely.contains(shape, points), -distance, distance))
    return np.concatenate(out)


def _fine(axis: Array) -> Array:
    return np.geomspace(axis[0], axis[-1], FINE) if len(axis) > 1 else np.asarray(axis, dtype=float)


def _interpolated(
    distances: Array, candidates: Candidates, friction: Array, stretch: Array, huber: float
) -> tuple[Array, Array]:
    """Return the mean squared distance and the mean Huber loss [m2] on the fine grid, each (friction, stretch)."""
    if len(candidates.stretch) > 1:
        axes = (np.log(candidates.friction), np.log(candidates.stretch))
        at = np.stack(np.meshgrid(np.log(friction), np.log(stretch), indexing="ij"), axis=-1)
        d = RegularGridInterpolator(axes, distances)(at.clip([a[0] for a in axes], [a[-1] for a in axes]))
    else:
        axis = np.log(candidates.friction)
        at = np.log(friction)[:, None].clip(axis[0], axis[-1])
        d = RegularGridInterpolator((axis,), distances[:, 0])(at)[:, None]
    size = np.abs(d)
    loss = np.where(size <= huber, size**2, huber * (2.0 * size - huber))
    return (d**2).mean(axis=-1), loss.mean(axis=-1)


def _weights(log_density: Array) -> Array:
    w = np.exp(log_density - log_density.max())
    return w / w.sum()


def _quantity(values: Array, before: Array, after: Array) -> Quantity:
    mean = float(after @ values)
    variance = float(after @ (values - mean) ** 2)
    prior = float(before @ (values - before @ values) ** 2)
    learned = 1.0 - variance / prior if prior > 0.0 else 0.0
    return Quantity(mean, float(np.sqrt(variance)), max(0.0, learned))
