"""Registration of a garment: bends the template's contour onto the observed boundary and yields the key points.

This is the paper's registration (see `energy`). The template's vertices are feature points and keep their
identity. The fit consists of rounds. In each round, Levenberg-Marquardt steps (Madsen, Nielsen and Tingleff 2004,
section 3.2, analytic Jacobian) move the contour, and segments are subdivided and merged. The result is the
reference of the next round, from which stretching and bending are measured. The fit starts from every plausible
orientation, and the result of lowest energy is chosen. At the end the corners are relocated on the boundary
(`corners`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.outline import (
    GarmentOutline,
    MemberOutline,
    counter_clockwise,
    interior_angles,
    polygon_area,
    segment_lengths,
    symmetries,
)
from foldcell.skills.perception.registration.corners import (
    HOLLOW_ANGLE,
    NOTCH_ANGLE,
    ROUND_END,
    least_turn,
    set_corners,
)
from foldcell.skills.perception.registration.energy import (
    Boundary,
    EnergyWeights,
    closest_segments,
    contour_terms,
    solve_damped,
)
from foldcell.skills.plane import rotation

_MARGIN = 0.005
"""An orientation is ruled out if its forward distance exceeds twice the smallest one by more than this [m]."""


_EQUAL = 0.004
"""Two orientations whose mean boundary distances differ by less than this are equally good [m]."""
_STEPS_EACH = 6
"""Maximum number of Levenberg-Marquardt steps in a round of the fit."""


@dataclass(frozen=True)
class FitSettings:
    """How a template is fitted. Lengths [m]. Segments longer than `longest` are split; neighbouring segments that
    are both shorter than `shortest` are merged."""

    weights: EnergyWeights = field(default_factory=EnergyWeights)
    longest: float = 0.06
    shortest: float = 0.015
    updates: int = 12
    """Maximum number of rounds. After each round, its result becomes the new reference."""
    reduction: float = 0.05
    """The fit ends when a round lowers the energy by less than this fraction."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Result of a registration. keypoints: name -> (2,) [m]. sigmas: name -> standard deviation of this place [m].
    contour: (n, 2) registered contour, counter-clockwise; it includes the key points [m].

    residual: root mean square boundary distance [m]. scale: observed size over the template's size. ambiguous:
    symmetries of the template, see `symmetries`; if there are any, the orientation nearest to that of the template
    is chosen. history: energy [m3] before the first and after each round of the fit. stages: the contours that
    have these energies. least_turn: see `corners.least_turn`; straightest: name of
    the key point that has it. relocated: names of the key points that were
    located afterwards in the picture, or by the whole upper edge, see `details`.
    """

    keypoints: Mapping[str, Array]
    sigmas: Mapping[str, float]
    contour: Array
    residual: float
    scale: float
    ambiguous: tuple[str, ...]
    history: tuple[float, ...]
    stages: tuple[Array, ...]
    least_turn: float
    straightest: str
    relocated: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Start:
    """A template placed on the boundary. polygon: (k, 2) its vertices [m]. angle: its rotation [rad]. distance:
    mean distance between polygon and boundary [m]."""

    polygon: Array
    angle: float
    distance: float


def register(contour: Array, garment: GarmentOutline) -> Registration:
    """Fit the garment's template to an observed boundary (n, 2) [m], table frame, closed implicitly. A member of
    its category starts where it was placed."""
    settings = FitSettings()
    contour = counter_clockwise(contour)
    boundary = Boundary(contour)
    polygon = counter_clockwise(garment.template)
    names = garment.keypoints[::-1] if polygon_area(garment.template) < 0 else garment.keypoints
    if isinstance(garment, MemberOutline):
        fits = [fit(garment.placed, boundary, replace(settings, updates=1), garment.feature)]
    else:
        fits = [fit(start.polygon, boundary, settings) for start in best_starts(polygon, boundary)]
    X, feature, history, stages = min(fits, key=lambda f: _score(f[0], f[1], polygon, boundary, settings))
    vertices = np.flatnonzero(feature >= 0)
    fitted = isinstance(garment, MemberOutline)
    rounded = names.index(ROUND_END) if fitted and ROUND_END in names else -1
    X, sigma = set_corners(X, feature, polygon, boundary, fitted, rounded)
    sigmas = {names[feature[vertex]]: float(s) for vertex, s in zip(vertices, sigma, strict=True)}
    points = {names[feature[i]]: frozen(X[i].copy()) for i in vertices}
    angles = interior_angles(polygon)[feature[vertices]]
    expected = _turns_with_bends(garment)[feature[vertices]] if isinstance(garment, MemberOutline) else angles
    notch = np.zeros(len(X), bool)
    notch[vertices] = angles > NOTCH_ANGLE
    # The boundary at a notch is not visible, so the two segments that end there are excluded.
    turn, straightest = least_turn(X[vertices], expected, boundary)
    distance, _ = boundary.distance(0.5 * (X + np.roll(X, -1, axis=0))[~(notch | np.roll(notch, -1))])
    return Registration(
        keypoints={name: points[name] for name in garment.keypoints},
        sigmas={name: sigmas[name] for name in garment.keypoints},
        contour=frozen(X),
        residual=float(np.sqrt(np.mean(distance**2))),
        scale=float(np.sqrt(polygon_area(contour) / polygon_area(polygon))),
        ambiguous=symmetries(polygon),
        history=tuple(history),
        stages=tuple(frozen(stage) for stage in stages),
        least_turn=turn,
        straightest=names[feature[vertices[straightest]]],
    )


def _turns_with_bends(garment: MemberOutline) -> Array:
    """Return the interior angles (k,) at the key points [rad]. A bend next to a key point takes a part of its
    turn: the middle of a round neckline hardly turns. A hollow corner counts as a notch, because the outline often
    ends before it, and so do shoulders and collar of a shirt, which are located by the whole upper edge."""
    of_key_points = garment.feature >= 0
    angles = np.empty(len(garment.keypoints))
    angles[garment.feature[of_key_points]] = interior_angles(garment.placed)[of_key_points]
    shirt = any(name.startswith("cuff_upper") for name in garment.keypoints)
    upper = np.array([shirt and name.startswith(("shoulder", "collar")) for name in garment.keypoints])
    return np.where((angles > HOLLOW_ANGLE) | upper, 2.0 * np.pi, angles)


# --- where to start ------------------------------------------------------------------------------------


def best_starts(
    polygon: Array, boundary: Boundary, candidates: int = 3, turns: Sequence[float] = ()
) -> list[Start]:
    """Place the template (k, 2), counter-clockwise, in each plausible orientation, best first, `candidates` at
    most. turns: further orientations to try [rad]."""
    return _plausible(_placements(polygon, boundary, turns))[:candidates]


def _placements(polygon: Array, boundary: Boundary, turns: Sequence[float]) -> list[Start]:
    """Place the template in the given orientations and all that moments and smallest enclosing rectangle suggest,
    best first."""
    observed, template_axes = _axes(boundary.samples), _axes(polygon)
    angles = [*turns]
    for a in observed:
        for b in template_axes:
            angles += [a - b + k * np.pi / 2 for k in range(4)]
    placed: list[tuple[Array, float, float]] = []
    for angle in map(_wrap, angles):
        if all(abs(_wrap(angle - a)) > np.deg2rad(3) for _, a, _ in placed):
            X = _place(polygon, angle, boundary)
            placed.append((X, angle, _forward_distance(X, boundary)))
    # The forward distance is that of the template from the boundary. The reverse distance is expensive, so it is
    # computed only if the forward distance is at most about twice the smallest one.
    max_forward = 2.0 * min(forward for _, _, forward in placed) + _MARGIN
    starts = [
        Start(X, angle, 0.5 * (forward + _reverse_distance(X, boundary)))
        for X, angle, forward in placed
        if forward <= max_forward
    ]
    return sorted(starts, key=lambda s: s.distance)


def _plausible(starts: list[Start]) -> list[Start]:
    """Select the orientations that are worth a full fit.

    If two orientations half a turn apart are equally good, the silhouette cannot show which one is right. Only the
    one that is nearer to the template's own orientation is used.
    """
    best = starts[0].distance
    equal = [s for s in starts if s.distance <= best + _EQUAL]
    first = min(equal, key=lambda s: (abs(s.angle) > np.deg2rad(91), s.distance))
    half_turned = [s for s in equal if abs(_wrap(s.angle - first.angle)) > np.deg2rad(60)]
    upright = min([first, *half_turned], key=lambda s: round(abs(s.angle), 3))
    rest = [s for s in starts if s.distance <= 1.6 * best + _EQUAL and s not in half_turned and s is not first]
    return [upright, *rest]


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _axes(points: Array) -> tuple[float, float]:
    """Directions [rad] of the long edge of the smallest enclosing rectangle, and of the long principal axis."""
    corners = cv2.boxPoints(cv2.minAreaRect(points.astype(np.float32)))
    a, b = corners[1] - corners[0], corners[2] - corners[1]
    long = a if a @ a >= b @ b else b
    _, axes = np.linalg.eigh(np.cov(points.T))
    return float(np.arctan2(long[1], long[0])), float(np.arctan2(axes[1, 1], axes[0, 1]))


def _place(polygon: Array, angle: float, boundary: Boundary) -> Array:
    """Rotate the template by `angle` [rad], and stretch its extents to the observed ones. The stretch along one
    axis differs from the mean stretch by a quarter at most."""
    R = rotation(angle)
    rotated = boundary.samples @ R
    low, high = rotated.min(axis=0), rotated.max(axis=0)
    extent = np.ptp(polygon, axis=0)
    stretch = (high - low) / extent
    size = float(np.sqrt(stretch.prod()))
    stretch = np.clip(stretch, 0.8 * size, 1.25 * size)
    middle = 0.5 * (polygon.min(axis=0) + polygon.max(axis=0))
    return ((polygon - middle) * stretch + 0.5 * (low + high)) @ R.T


def _forward_distance(polygon: Array, boundary: Boundary) -> float:
    """Mean distance of points on a placed template from the boundary [m]."""
    X = _subdivide(polygon, np.arange(len(polygon)), 0.03)[0]
    return float(boundary.nearest(X)[0].mean())


def _reverse_distance(polygon: Array, boundary: Boundary) -> float:
    """Mean distance of the boundary's samples from a placed template [m]."""
    _, _, foot = closest_segments(polygon, boundary.samples, boundary.sample_normals, normal_reach=0.0)
    return float(np.linalg.norm(foot - boundary.samples, axis=1).mean())


def _score(
    X: Array, feature: NDArray[np.intp], polygon: Array, boundary: Boundary, settings: FitSettings
) -> float:
    """Energy of a finished fit: stretch and bending of its corners relative to the template, and the data
    terms."""
    corners = X[feature >= 0]
    scale = np.sqrt(abs(polygon_area(corners) / polygon_area(polygon)))
    r = contour_terms(corners, polygon * scale, boundary, settings.weights).r
    n = len(corners)
    return float((r[n : 3 * n] ** 2).sum()) + _energy(X, boundary, settings)


# --- the fit -------------------------------------------------------------------------------------------


def fit(
    polygon: Array, boundary: Boundary, settings: FitSettings, feature: NDArray[np.intp] | None = None
) -> tuple[Array, NDArray[np.intp], list[float], list[Array]]:
    """Fit a placed template (k, 2) to the boundary. feature: (k,) index of the key point of each vertex, -1 for
    none; without it, all are key points, in this order.

    Returns the registered contour (n, 2) [m]; the index of each vertex's key point (n,), -1 for none; the energies
    before the first and after each round; and the contours that have these energies.
    """
    X, feature = _subdivide(polygon, np.arange(len(polygon)) if feature is None else feature, settings.longest)
    history, stages = [_energy(X, boundary, settings)], [X]
    for _ in range(settings.updates):
        X = _levenberg_marquardt(X, boundary, settings)
        X, feature = _subdivide(X, feature, settings.longest)
        X, feature = _merge(X, feature, settings.shortest)
        history.append(_energy(X, boundary, settings))
        stages.append(X)
        if history[-1] > (1 - settings.reduction) * history[-2]:
            break
    return X, feature, history, stages


def _energy(X: Array, boundary: Boundary, settings: FitSettings) -> float:
    return contour_terms(X, X, boundary, settings.weights).energy


def _levenberg_marquardt(X: Array, boundary: Boundary, settings: FitSettings) -> Array:
    """Fit the contour to the boundary by a few Levenberg-Marquardt steps. Its shape at the start, X (n, 2), is the
    one from which the energy of deformation is measured."""
    reference = X
    terms = contour_terms(X, reference, boundary, settings.weights)
    (A, g), energy = terms.normal_equations(), terms.energy
    damping, growth = 1e-3 * float(A.diagonal().max()), 2.0
    for _ in range(_STEPS_EACH):
        step = -solve_damped(A, g, damping)
        candidate = X + step.reshape(-1, 2)
        terms = contour_terms(candidate, reference, boundary, settings.weights)
        gain = energy - terms.energy
        predicted = float((step * (damping * step - g)).sum())
        if gain > 0 and predicted > 0:
            X, energy = candidate, energy - gain
            A, g = terms.normal_equations()
            damping *= max(1 / 3, 1 - (2 * gain / predicted - 1) ** 3)
            growth = 2.0
            if gain < 1e-3 * energy:
                break
        else:
            damping, growth = damping * growth, growth * 2
    return X


def _subdivide(X: Array, feature: NDArray[np.intp], longest: float) -> tuple[Array, NDArray[np.intp]]:
    """Split each segment that is longer than `longest` into equal parts."""
    parts = np.maximum(np.ceil(segment_lengths(X) / longest).astype(np.intp), 1)
    segment = np.repeat(np.arange(len(X)), parts)
    k = np.arange(len(segment)) - np.repeat(np.cumsum(parts) - parts, parts)
    t = (k / parts[segment])[:, None]
    points = (1 - t) * X[segment] + t * X[(segment + 1) % len(X)]
    return points, np.where(k == 0, feature[segment], -1).astype(np.intp)


def _merge(X: Array, feature: NDArray[np.intp], shortest: float) -> tuple[Array, NDArray[np.intp]]:
    """Remove vertices between two short segments, unless they are feature points."""
    lengths = segment_lengths(X)
    keep = np.ones(len(X), bool)
    for i in range(len(X)):
        before = (i - 1) % len(X)
        if feature[i] < 0 and keep[before] and max(lengths[i], lengths[before]) < shortest:
            keep[i] = False
    return X[keep], feature[keep]
