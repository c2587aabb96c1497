"""Final localisation of the corners of a registered contour.

A sharp corner moves to the tip of the boundary's corner, a crotch to the intersection of the adjoining edges. A
blunt corner moves to the mean of its registered place and its place by the garment's body.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array
from skills.perception.registration.body import BodySettings, lay_body
from skills.perception.registration.energy import Boundary, closest_segments, interior_angles, segment_lengths
from skills.perception.template import polygon_area

__all__ = ["CornerSettings", "least_turn", "set_corners"]


_TIP = 8
"""Search range for a corner's tip, in boundary points before and after the nearest one."""


@dataclass(frozen=True)
class CornerSettings:
    """Lengths [m], angles [rad]."""

    notch_angle: float = 5.6
    """Interior angle from which a corner is a notch between two limbs."""
    sharp: float = 0.7
    """Sine of the angle from which a corner is sharp."""
    snap: float = 0.03
    """Maximum displacement of a corner."""
    notch: float = 0.25
    """Maximum displacement of a notch."""
    edge: float = 0.08
    notch_edge: float = 0.16
    """Length of the edges considered at a corner, and at a notch."""
    line_sigma: float = 0.0025
    """Standard deviation of a line through the boundary where it meets another."""
    template_sigma: float = 0.004
    """Standard deviation of the template's proportions from one corner to its neighbours."""
    smoothed: float = 0.0015
    """Length that segmentation removes from a very acute corner."""
    normal_reach: float = 0.05
    body: BodySettings = field(default_factory=BodySettings)


def set_corners(
    X: Array,
    feature: NDArray[np.intp],
    polygon: Array,
    boundary: Boundary,
    settings: CornerSettings | None = None,
) -> Array:
    """The registered contour X (n, 2) [m] with its feature points, feature (n,) >= 0, relocated.

    polygon: (k, 2) the template, counter-clockwise; feature holds the indices of its vertices.

    Straight lines are fitted to the edges on both sides of a corner. A sewn corner is round: its tip is the
    boundary point that reaches furthest towards the intersection of the lines. Near a crotch the table between the
    legs is too narrow to be visible, so the intersection itself is used. The edges meet there at an acute angle,
    so the template serves as a prior.
    """
    settings = settings or CornerSettings()
    moved = X.copy()
    corners = np.flatnonzero(feature >= 0)
    angles = interior_angles(polygon)[feature[corners]]
    clear = np.sin(angles) ** 2
    shape = polygon[feature[corners]]
    q, normals = boundary.points[::2], boundary.normals[::2]
    segment, t, _ = closest_segments(X, q, normals, settings.normal_reach)
    point_arc, corner_arc = _arc_position(X, segment, t), _arc_position(X, corners, np.zeros(len(corners)))
    total = float(segment_lengths(X).sum())
    blunt = (angles <= settings.notch_angle) & (np.abs(np.sin(angles)) < settings.sharp)
    body = lay_body(shape, X[corners], clear > 0.5, boundary, settings.body) if blunt.any() else None
    for k, vertex in enumerate(corners):
        if blunt[k]:
            # The mean of two estimates with about equal and nearly independent errors.
            place = X[vertex] if body is None else 0.5 * (X[vertex] + body[k])
            moved[vertex] = boundary.points[boundary.nearest(place[None])[1][0]]
            continue
        notch = bool(angles[k] > settings.notch_angle)
        lines = _edge_lines(k, corner_arc, total, q, point_arc, settings.notch_edge if notch else settings.edge)
        if len(lines) < 2:
            continue
        if notch:
            tip = _map_estimate(lines, _by_template(k, shape, X[corners], clear), settings)
        else:
            meeting = _intersection(lines)
            tip = (
                X[vertex]
                if meeting is None
                else _rounded_corner_tip(meeting, lines, angles[k], boundary, settings)
            )
        if np.linalg.norm(tip - X[vertex]) <= (settings.notch if notch else settings.snap):
            moved[vertex] = tip
    return moved


def least_turn(corners: Array, angles: Array, boundary: Boundary, settings: CornerSettings | None = None) -> float:
    """Turn of the boundary at a sharp corner's place, relative to the corner's own: the minimum over corners.

    corners: (k, 2) [m]. angles: (k,) interior angles of the template [rad]. A ratio near 0 means that the corner
    was placed along an edge. Notches are ignored, because their inside is not visible.
    """
    settings = settings or CornerSettings()
    sharp = (np.abs(np.sin(angles)) >= settings.sharp) & (angles <= settings.notch_angle)
    if not sharp.any():
        return 1.0
    n, points = len(boundary.points), boundary.points
    near, far = _TIP, 3 * _TIP
    nearest_index = boundary.nearest(corners[sharp])[1]
    # The corner may be round and a little displaced: the chords start beside it.
    shares = []
    for offset in (-near, 0, near):
        i = nearest_index + offset
        incoming = points[(i - near) % n] - points[(i - far) % n]
        outgoing = points[(i + far) % n] - points[(i + near) % n]
        cross = incoming[:, 0] * outgoing[:, 1] - incoming[:, 1] * outgoing[:, 0]
        turn = np.arctan2(cross, (incoming * outgoing).sum(axis=1))
        shares.append(turn / (np.pi - angles[sharp]))
    return float(np.max(shares, axis=0).min())


def _edge_lines(
    k: int, corner_arc: Array, total: float, q: Array, point_arc: Array, reach: float
) -> list[tuple[Array, Array]]:
    """Lines (point, unit direction) through the boundary up to `reach` [m] before and after the k-th corner.

    corner_arc: (c,) arc positions of the corners, point_arc: (m,) of the boundary's points q (m, 2), total: length
    of the contour [m].
    """
    lines = []
    for sign, other in ((-1.0, corner_arc[k - 1]), (1.0, corner_arc[(k + 1) % len(corner_arc)])):
        span = (sign * (other - corner_arc[k])) % total
        distance = (sign * (point_arc - corner_arc[k])) % total
        chosen = (distance > min(0.014, 0.25 * span)) & (distance < min(0.55 * span, reach))
        line = _line(q[chosen])
        if line is not None:
            lines.append(line)
    return lines


def _by_template(k: int, shape: Array, placed: Array, clear: Array) -> Array:
    """Place of the k-th corner by a rigid motion of `shape` (n, 2) to `placed` (n, 2); near corners count more.

    clear: (n,) 0..1, distinctness of each corner.
    """
    shape = shape * np.sqrt(abs(polygon_area(placed) / polygon_area(shape)))
    weight = clear / np.maximum(np.linalg.norm(shape - shape[k], axis=1), 1e-2) ** 3
    weight[k] = 0.0
    weight /= weight.sum()
    from_, to = weight @ shape, weight @ placed
    a, b = shape - from_, placed - to
    along = float((weight[:, None] * a * b).sum())
    across = float((weight * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum())
    R = np.array([[along, -across], [across, along]]) / np.hypot(along, across)
    return np.asarray(to + R @ (shape[k] - from_))


def _map_estimate(lines: list[tuple[Array, Array]], prior: Array, settings: CornerSettings) -> Array:
    """Maximum a posteriori estimate of the intersection of two lines (`line_sigma`) with a prior place
    (`template_sigma`)."""
    A, b = np.eye(2) / settings.template_sigma**2, prior / settings.template_sigma**2
    for point, direction in lines:
        normal = np.array([-direction[1], direction[0]])
        A = A + np.outer(normal, normal) / settings.line_sigma**2
        b = b + normal * float(normal @ point) / settings.line_sigma**2
    return np.asarray(np.linalg.solve(A, b))


def _intersection(lines: list[tuple[Array, Array]]) -> Array | None:
    (a, u), (b, v) = lines
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) < 0.25:
        return None
    d = b - a
    return np.asarray(a + u * (d[0] * v[1] - d[1] * v[0]) / cross)


def _rounded_corner_tip(
    corner: Array, lines: list[tuple[Array, Array]], angle: float, boundary: Boundary, settings: CornerSettings
) -> Array:
    """Tip of a round corner: the boundary point furthest along the bisector of the edges, corrected for the length
    that smoothing the picture removed."""
    _, nearest = boundary.nearest(corner[None])
    near = boundary.points[(nearest[0] + np.arange(-_TIP, _TIP + 1)) % len(boundary.points)]
    outwards = sum(_towards(corner, point, u) for point, u in lines)
    tip = near[int(np.argmax(near @ outwards))]
    missing = corner - tip
    missing_length = float(np.linalg.norm(missing))
    removed = settings.smoothed * abs(float(np.cos(0.5 * angle)))
    return np.asarray(tip + missing * min(1.0, removed / max(missing_length, 1e-9)))


def _towards(corner: Array, point: Array, direction: Array) -> Array:
    """Unit vector along a line through `point` towards the corner."""
    return direction * np.sign(float(direction @ (corner - point)))


def _arc_position(X: Array, segment: NDArray[np.intp], t: Array) -> Array:
    lengths = segment_lengths(X)
    start = np.r_[0.0, np.cumsum(lengths)[:-1]]
    return start[segment] + t * lengths[segment]


def _line(points: Array) -> tuple[Array, Array] | None:
    """Total least-squares line (point, unit direction), fitted again without the worst fifth of the points."""
    if len(points) < 6:
        return None
    for _ in range(2):
        middle = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
        distance = np.abs((points - middle) @ np.array([-axes[0, 1], axes[0, 0]]))
        points = points[distance <= np.quantile(distance, 0.8) + 1e-9]
    return middle, axes[0]
