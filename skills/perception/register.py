"""Where a garment's key points lie: its template's contour, bent onto the observed boundary.

The paper's registration (see `energy`): the template's vertices are feature points and keep their identity;
Levenberg-Marquardt steps (Madsen, Nielsen and Tingleff 2004, section 3.2, analytic Jacobian) move the
contour, segments are subdivided and merged, the reference follows. It starts from every orientation that
the silhouette allows, and the energy says which is right. At the end each corner is set to where the two
edges beside it meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen
from skills.perception.energy import (
    Boundary,
    EnergyWeights,
    closest_segments,
    contour_terms,
    interior_angles,
    segment_lengths,
    solve_damped,
)
from skills.perception.template import GarmentOutline, polygon_area, symmetries

__all__ = ["Registration", "RegistrationSettings", "Start", "bend", "best_starts", "fit", "register"]


_NOTCH = 5.6
"""Interior angle from which a corner is a notch between two limbs [rad]."""
_SHARP = 0.7
"""Sine of the angle from which a corner is sharp."""
_SMOOTHED = 0.004
"""What segmentation takes off a very acute corner [m]."""


@dataclass(frozen=True)
class RegistrationSettings:
    """Lengths [m]. Segments longer than `longest` are split, neighbours shorter than `shortest` are merged."""

    weights: EnergyWeights = field(default_factory=EnergyWeights)
    longest: float = 0.06
    shortest: float = 0.015
    steps_each: int = 6
    """Levenberg-Marquardt steps between two updates of the reference."""
    updates: int = 12
    reduction: float = 0.05
    """The registration ends when an update lowers the energy by less than this share."""
    equal: float = 0.004
    """Mean boundary distances closer than this do not tell two orientations apart [m]."""
    candidates: int = 3
    snap: float = 0.03
    """A corner is moved by at most this much at the end [m]; 0 leaves the registered ones."""
    notch: float = 0.08
    """As `snap`, for a crotch."""
    edge: float = 0.08
    notch_edge: float = 0.16
    """How far from a corner, and from a crotch, the edges are looked at [m]."""
    line_sigma: float = 0.0025
    """How well a line through the boundary is known where it meets another [m]."""
    template_sigma: float = 0.006
    """How well the template's proportions hold from one corner to its neighbours [m]."""


@dataclass(frozen=True, eq=False)
class Registration:
    """keypoints: name -> (2,) [m]. contour: (n, 2) registered, counter-clockwise, key points among it.

    energy: the data terms at the end [m3]; residual: root mean square boundary distance [m]. angle: by
    which the template was turned first [rad]; scale: observed size / template's. ambiguous: symmetries
    that the silhouette leaves open; the orientation nearest to that of the template is then chosen.
    history: energy after each update.
    """

    keypoints: Mapping[str, Array]
    contour: Array
    energy: float
    residual: float
    angle: float
    scale: float
    ambiguous: tuple[str, ...]
    history: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Start:
    """A template laid over the boundary: polygon (k, 2), turned by `angle` [rad]; mean distance [m]."""

    polygon: Array
    angle: float
    distance: float


def register(
    contour: Array, garment: GarmentOutline, settings: RegistrationSettings | None = None
) -> Registration:
    """Fit the garment's template to an observed boundary (n, 2) [m], table frame, closed implicitly."""
    settings = settings or RegistrationSettings()
    contour = np.asarray(contour, dtype=float)
    if polygon_area(contour) < 0:
        contour = contour[::-1]
    boundary = Boundary(contour)
    template = np.asarray(garment.template, dtype=float)
    clockwise = polygon_area(template) < 0
    polygon = template[::-1] if clockwise else template
    names = garment.keypoints[::-1] if clockwise else garment.keypoints
    open_to = symmetries(polygon)
    starts = best_starts(polygon, boundary, settings)
    fits = [(fit(start.polygon, boundary, settings), start) for start in starts]
    (X, feature, history), start = min(fits, key=lambda f: _judge(f[0][0], f[0][1], polygon, boundary, settings))
    if settings.snap > 0:
        X = _snap_corners(X, feature, polygon, boundary, settings)
    vertices = np.flatnonzero(feature >= 0)
    points = {names[feature[i]]: frozen(X[i].copy()) for i in vertices}
    distance, _ = boundary.distance(0.5 * (X + np.roll(X, -1, axis=0)))
    return Registration(
        keypoints={name: points[name] for name in garment.keypoints},
        contour=frozen(X),
        energy=history[-1],
        residual=float(np.sqrt(np.mean(distance**2))),
        angle=start.angle,
        scale=float(np.sqrt(polygon_area(contour) / polygon_area(polygon))),
        ambiguous=open_to,
        history=tuple(history),
    )


def best_starts(polygon: Array, boundary: Boundary, settings: RegistrationSettings) -> list[Start]:
    """The template (k, 2), counter-clockwise, in each plausible orientation, best first."""
    return _plausible(_starts(polygon, boundary), settings)


def bend(polygon: Array, boundary: Boundary, settings: RegistrationSettings) -> Array:
    """The placed template bent onto the boundary, without snapping its corners: (n, 2) [m]."""
    return fit(polygon, boundary, settings)[0]


# --- where to start ------------------------------------------------------------------------------------


def _starts(polygon: Array, boundary: Boundary) -> list[Start]:
    """The template in every orientation suggested by moments and the smallest rectangle, best first."""
    observed, ours = _axes(boundary.samples), _axes(polygon)
    angles: list[float] = []
    for a in observed:
        for b in ours:
            angles += [a - b + k * np.pi / 2 for k in range(4)]
    starts: list[Start] = []
    for angle in angles:
        angle = float((angle + np.pi) % (2 * np.pi) - np.pi)
        if all(abs(_wrap(angle - s.angle)) > np.deg2rad(3) for s in starts):
            placed = _place(polygon, angle, boundary)
            starts.append(Start(placed, angle, _boundary_distance(placed, boundary)))
    return sorted(starts, key=lambda s: s.distance)


def _plausible(starts: list[Start], settings: RegistrationSettings) -> list[Start]:
    """Orientations worth a full fit. Those as good as the best, half a turn away, are the same silhouette:
    of these only the one nearest to the template's own orientation is kept."""
    best = starts[0].distance
    equal = [s for s in starts if s.distance <= best + settings.equal]
    first = min(equal, key=lambda s: (abs(s.angle) > np.deg2rad(91), s.distance))
    twins = [s for s in equal if abs(_wrap(s.angle - first.angle)) > np.deg2rad(60)]
    upright = min([first, *twins], key=lambda s: round(abs(s.angle), 3))
    rest = [s for s in starts if s.distance <= 1.6 * best + settings.equal and s not in twins and s is not first]
    return [upright, *rest][: settings.candidates]


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _axes(points: Array) -> tuple[float, float]:
    """Directions [rad] of the smallest enclosing rectangle's edge and of the long principal axis."""
    corners = cv2.boxPoints(cv2.minAreaRect(points.astype(np.float32)))
    a, b = corners[1] - corners[0], corners[2] - corners[1]
    long = a if a @ a >= b @ b else b
    _, axes = np.linalg.eigh(np.cov(points.T))
    return float(np.arctan2(long[1], long[0])), float(np.arctan2(axes[1, 1], axes[0, 1]))


def _place(polygon: Array, angle: float, boundary: Boundary) -> Array:
    """The template turned by `angle`, its extents stretched to the observed ones (by a quarter at most)."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    seen = boundary.samples @ R
    low, high = seen.min(axis=0), seen.max(axis=0)
    extent = np.ptp(polygon, axis=0)
    stretch = (high - low) / extent
    size = float(np.sqrt(stretch.prod()))
    stretch = np.clip(stretch, 0.8 * size, 1.25 * size)
    middle = 0.5 * (polygon.min(axis=0) + polygon.max(axis=0))
    return ((polygon - middle) * stretch + 0.5 * (low + high)) @ R.T


def _boundary_distance(polygon: Array, boundary: Boundary) -> float:
    """Mean distance between two boundaries, both ways [m]."""
    X = _subdivide(polygon, np.arange(len(polygon)), 0.03)[0]
    there, _ = boundary.nearest(X)
    _, _, foot = closest_segments(X, boundary.samples, boundary.sample_normals, 0.0)
    back = np.linalg.norm(foot - boundary.samples, axis=1)
    return 0.5 * float(there.mean() + back.mean())


def _judge(
    X: Array, feature: NDArray[np.intp], polygon: Array, boundary: Boundary, settings: RegistrationSettings
) -> float:
    """The energy of a finished fit with the template itself as the reference."""
    corners = X[feature >= 0]
    scale = np.sqrt(abs(polygon_area(corners) / polygon_area(polygon)))
    r = contour_terms(corners, polygon * scale, boundary, settings.weights).r
    n = len(corners)
    return float((r[n : 3 * n] ** 2).sum()) + _energy(X, boundary, settings)


# --- the fit -------------------------------------------------------------------------------------------


def fit(
    polygon: Array, boundary: Boundary, settings: RegistrationSettings
) -> tuple[Array, NDArray[np.intp], list[float]]:
    """Registered contour (n, 2), which key point each vertex is (-1: none), and the energies."""
    X, feature = _subdivide(polygon, np.arange(len(polygon)), settings.longest)
    history = [_energy(X, boundary, settings)]
    for _ in range(settings.updates):
        X = _levenberg_marquardt(X, boundary, settings)
        X, feature = _subdivide(X, feature, settings.longest)
        X, feature = _merge(X, feature, settings.shortest)
        history.append(_energy(X, boundary, settings))
        if history[-1] > (1 - settings.reduction) * history[-2]:
            break
    return X, feature, history


def _energy(X: Array, boundary: Boundary, settings: RegistrationSettings) -> float:
    return contour_terms(X, X, boundary, settings.weights).energy


def _levenberg_marquardt(X: Array, boundary: Boundary, settings: RegistrationSettings) -> Array:
    """A few damped Gauss-Newton steps against the reference `X` itself."""
    reference = X
    terms = contour_terms(X, reference, boundary, settings.weights)
    (A, g), energy = terms.normal_equations(), terms.energy
    damping, growth = 1e-3 * float(A.diagonal().max()), 2.0
    for _ in range(settings.steps_each):
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
    """Drop vertices between two short segments, unless one is a feature point."""
    lengths = segment_lengths(X)
    keep = np.ones(len(X), bool)
    for i in range(len(X)):
        before = (i - 1) % len(X)
        if feature[i] < 0 and keep[before] and max(lengths[i], lengths[before]) < shortest:
            keep[i] = False
    return X[keep], feature[keep]


# --- corners -------------------------------------------------------------------------------------------


def _snap_corners(
    X: Array, feature: NDArray[np.intp], polygon: Array, boundary: Boundary, settings: RegistrationSettings
) -> Array:
    """Each sharp corner of the template to the tip of the boundary's corner; a blunt one to between where it was
    registered and where the others would have it.

    Straight lines through the boundary on both sides say where the edges meet. A sewn corner is round, and its tip
    lies where the boundary comes nearest to that. Only between two legs, where the table is too narrow to be seen
    near the crotch, it is where the edges meet; as they do so at an acute angle, the template has a say.
    """
    moved = X.copy()
    corners = np.flatnonzero(feature >= 0)
    angles = interior_angles(polygon)[feature[corners]]
    clear = np.sin(angles) ** 2
    shape = polygon[feature[corners]]
    shape = shape * np.sqrt(abs(polygon_area(X[corners]) / polygon_area(shape)))
    q, normals = boundary.points[::2], boundary.normals[::2]
    segment, t, _ = closest_segments(X, q, normals, settings.weights.normal_reach)
    along, at = _arc_position(X, segment, t), _arc_position(X, corners, np.zeros(len(corners)))
    total = float(segment_lengths(X).sum())
    for k, vertex in enumerate(corners):
        notch = bool(angles[k] > _NOTCH)
        if not notch and abs(np.sin(angles[k])) < _SHARP:
            between = 0.3 * X[vertex] + 0.7 * _by_template(k, shape, X[corners], clear)
            moved[vertex] = boundary.points[boundary.nearest(between[None])[1][0]]
            continue
        lines = _edges(k, at, total, q, along, settings.notch_edge if notch else settings.edge)
        if len(lines) < 2:
            continue
        if notch:
            tip = _most_likely(lines, _by_template(k, shape, X[corners], clear), settings)
        else:
            meeting = _meet(lines)
            tip = X[vertex] if meeting is None else _round_tip(meeting, angles[k], boundary)
        if np.linalg.norm(tip - X[vertex]) <= (settings.notch if notch else settings.snap):
            moved[vertex] = tip
    return moved


def _edges(k: int, at: Array, total: float, q: Array, along: Array, reach: float) -> list[tuple[Array, Array]]:
    """Lines (point, unit direction) through the boundary up to `reach` before and after the k-th corner.

    at: (c,) arc positions of the corners, along: (m,) of the boundary's points q (m, 2), of `total` length.
    """
    lines = []
    for sign, other in ((-1.0, at[k - 1]), (1.0, at[(k + 1) % len(at)])):
        span = (sign * (other - at[k])) % total
        distance = (sign * (along - at[k])) % total
        chosen = (distance > min(0.014, 0.25 * span)) & (distance < min(0.55 * span, reach))
        line = _line(q[chosen])
        if line is not None:
            lines.append(line)
    return lines


def _by_template(k: int, shape: Array, placed: Array, clear: Array) -> Array:
    """Where the other corners have the k-th: the rigid motion that lays `shape` on `placed`, near corners best.

    clear: (n,) 0..1, how well each corner is seen by itself.
    """
    weight = clear / np.maximum(np.linalg.norm(shape - shape[k], axis=1), 1e-2) ** 3
    weight[k] = 0.0
    weight /= weight.sum()
    from_, to = weight @ shape, weight @ placed
    a, b = shape - from_, placed - to
    along = float((weight[:, None] * a * b).sum())
    across = float((weight * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum())
    R = np.array([[along, -across], [across, along]]) / np.hypot(along, across)
    return np.asarray(to + R @ (shape[k] - from_))


def _most_likely(lines: list[tuple[Array, Array]], wanted: Array, settings: RegistrationSettings) -> Array:
    """The maximum a posteriori of a point on two lines, each known to `line_sigma`, near `wanted`, to
    `template_sigma`."""
    A, b = np.eye(2) / settings.template_sigma**2, wanted / settings.template_sigma**2
    for point, direction in lines:
        normal = np.array([-direction[1], direction[0]])
        A = A + np.outer(normal, normal) / settings.line_sigma**2
        b = b + normal * float(normal @ point) / settings.line_sigma**2
    return np.asarray(np.linalg.solve(A, b))


def _meet(lines: list[tuple[Array, Array]]) -> Array | None:
    (a, u), (b, v) = lines
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) < 0.25:
        return None
    d = b - a
    return np.asarray(a + u * (d[0] * v[1] - d[1] * v[0]) / cross)


def _round_tip(corner: Array, angle: float, boundary: Boundary) -> Array:
    """The tip of a round corner: the boundary there, less what smoothing the picture took off it."""
    _, nearest = boundary.nearest(corner[None])
    tip = boundary.points[nearest[0]]
    missing = corner - tip
    far = float(np.linalg.norm(missing))
    cut = _SMOOTHED * abs(float(np.cos(0.5 * angle)))
    return np.asarray(tip + missing * min(1.0, cut / max(far, 1e-9)))


def _arc_position(X: Array, segment: NDArray[np.intp], t: Array) -> Array:
    lengths = segment_lengths(X)
    start = np.r_[0.0, np.cumsum(lengths)[:-1]]
    return start[segment] + t * lengths[segment]


def _line(points: Array) -> tuple[Array, Array] | None:
    """Total least squares line (point, unit direction), the worst fifth left out once."""
    if len(points) < 6:
        return None
    for _ in range(2):
        middle = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
        off = np.abs((points - middle) @ np.array([-axes[0, 1], axes[0, 0]]))
        points = points[off <= np.quantile(off, 0.8) + 1e-9]
    return middle, axes[0]
