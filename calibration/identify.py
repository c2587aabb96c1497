"""Friction and stretch from what a fold did: observed silhouettes against those predicted for candidate materials.

A fold that drags the cloth which should rest tells of the table's friction; a fold that drags nothing tells only
that the friction was enough. A garment's stretch moves its outline by a fraction of a millimetre, less than
a camera sees. Where the pictures say nothing the estimate is the prior.

What holds (tested on folds simulated with another mesh): where cloth was dragged the estimate moves to the side of
the prior on which the truth lies; where none was it stays with the prior. How far it moves is less sure: friction
0.65, 0.8 and 1.2 times the believed one was read as 0.70, 0.83 and 1.49 times, because at which friction cloth
begins to be dragged depends on the mesh. The deviations say how much was learned under `Noise`, which is assumed:
they are no validated confidence bounds.

Bayes on a grid: the signed distances of the observed outline from the predicted one are interpolated between
the candidates (linear in the logarithms of friction and stretch), and weighed by a robust (Huber) likelihood with
as many independent points as the outline has correlation lengths.
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
"""Candidates, as factors of what is believed."""
BOUND = 0.5
"""How far an update may lead away from the garment file's friction, as a share of it."""
POINTS = 240
"""Places along each observed outline that are compared."""
FINE = 81


@dataclass(frozen=True)
class Noise:
    """How far an observed outline may lie from a right prediction: sigma [m] (camera and simulation together),
    alike over `correlation` [m] of outline; huber [m]: beyond it a distance counts linearly. friction, stretch:
    relative standard deviation of what was believed before."""

    # assumed: what a simulation gets wrong is mostly a drift that the whole outline shares
    sigma: float = 0.004
    correlation: float = 0.50
    huber: float = 0.012
    friction: float = 0.30
    stretch: float = 0.30


@dataclass(frozen=True, eq=False)
class Candidates:
    """The grid: friction (f,) static coefficients and stretch (s,) fractions, both rising; shapes[i][j][k]: the
    silhouette (polygon, table frame [m]) in picture k that friction i and stretch j predict."""

    friction: Array
    stretch: Array
    shapes: Sequence[Sequence[Sequence[shapely.Geometry]]]


@dataclass(frozen=True)
class Quantity:
    """value and its standard deviation under `Noise`, as it is assumed; learned: the share of the prior's variance
    that the pictures took away (0: they say nothing, 1: all)."""

    value: float
    deviation: float
    learned: float


@dataclass(frozen=True)
class MaterialEstimate:
    """misfit: rms distance of the outlines at the estimate [m]; more than a few sigma: no candidate explains what
    is seen (the deviations are widened by it)."""

    friction: Quantity
    stretch: Quantity
    misfit: float

    def update_of(self, believed: Material, nominal: Material) -> Material:
        """`believed` with its friction moved towards the estimate by the share that was learned, in logarithms,
        and no further from the `nominal` one than BOUND."""
        before, lowest = believed.friction_static, (1.0 - BOUND) * nominal.friction_static
        moved = before * (self.friction.value / before) ** self.friction.learned
        return believed.with_friction(float(np.clip(moved, lowest, (1.0 + BOUND) * nominal.friction_static)))


def silhouette(vertices: Array, triangles: NDArray[np.int32]) -> shapely.Geometry:
    """The shape of a mesh seen from above: vertices (n, 3), triangles (m, 3)."""
    flat = shapely.polygons(np.asarray(vertices)[triangles][:, :, :2])
    return shapely.union_all(shapely.buffer(flat, 1e-5))


def outline_residual(contour: Array, vertices: Array, triangles: NDArray[np.int32]) -> float:
    """Root mean square distance [m] of an observed outline (k, 2) from a predicted shape, vertices (n, 3)."""
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
) -> Candidates:
    """Simulate the fold that was made from `positions` (n, 3) with each friction and stretch about `material`'s.

    One picture: the end of the fold. len(friction_factors) * len(stretch_factors) simulations. seen_as: where a
    camera sees vertices (n, 3) -> (n, 3), default from straight above.
    """
    friction = material.friction_static * np.sort(friction_factors)
    stretch = material.stretch_fraction * np.sort(stretch_factors)
    shapes = []
    for mu in friction:
        fabric = material.with_friction(float(mu))
        row = []
        for s in stretch:
            end = predict_fold(mesh, positions, replace(fabric, stretch_fraction=float(s)), paths)
            row.append((silhouette(seen_as(end.vertices), mesh.triangles),))
        shapes.append(row)
    return Candidates(friction, stretch, shapes)


def identify_material(
    observed: Sequence[Array], candidates: Candidates, believed: Material, noise: Noise | None = None
) -> MaterialEstimate:
    """What the observed outlines say of friction and stretch.

    observed: one contour (k, 2) [m] a picture, table frame, in the order of the candidates' pictures. believed:
    the prior's middle. Raises ConfigurationError for contours or candidates that do not fit.
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
            raise ConfigurationError(f"candidates of {name} must be positive and rise", "", values=list(axis))
    if len(candidates.friction) < 2:
        raise ConfigurationError("two candidates of friction at least", "", values=list(candidates.friction))
    if not observed or any(len(k) != len(observed) for row in candidates.shapes for k in row):
        raise ConfigurationError("each candidate needs one silhouette for each observed picture", "")
    for k, contour in enumerate(observed):
        c = np.asarray(contour, dtype=float)
        if c.ndim != 2 or c.shape[1] != 2 or len(c) < 3 or not np.isfinite(c).all():
            raise ConfigurationError("an observed contour is (k, 2), finite", "", picture=k, shape=c.shape)


def _distances(rings: Sequence[shapely.LinearRing], shapes: Sequence[shapely.Geometry]) -> Array:
    """(pictures * POINTS,) [m]: of points along the observed outlines from the predicted, outside positive."""
    out = []
    for ring, shape in zip(rings, shapes, strict=True):
        points = shapely.line_interpolate_point(
            ring, np.linspace(0.0, 1.0, POINTS, endpoint=False), normalized=True
        )
        away = shapely.distance(shapely.boundary(shape), points)
        out.append(np.where(shapely.contains(shape, points), -away, away))
    return np.concatenate(out)


def _fine(axis: Array) -> Array:
    return np.geomspace(axis[0], axis[-1], FINE) if len(axis) > 1 else np.asarray(axis, dtype=float)


def _interpolated(
    distances: Array, candidates: Candidates, friction: Array, stretch: Array, huber: float
) -> tuple[Array, Array]:
    """Mean squared distance and mean Huber loss [m2] on the fine grid, (friction, stretch)."""
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
