"""Where exactly the corners of a registered contour are.

A sharp corner is set to the tip of the boundary's corner, a crotch to where the edges beside it meet, a blunt one
to between where it was registered and where the garment's body has it.
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
"""How many points of the boundary before and after the nearest one a corner's tip is looked for."""


@dataclass(frozen=True)
class CornerSettings:
    """Lengths [m], angles [rad]."""

    notch_angle: float = 5.6
    """Interior angle from which a corner is a notch between two limbs."""
    sharp: float = 0.7
    """Sine of the angle from which a corner is sharp."""
    snap: float = 0.03
    """A corner is moved by at most this much."""
    notch: float = 0.25
    """As `snap`, for a notch."""
    edge: float = 0.08
    notch_edge: float = 0.16
    """How far from a corner, and from a notch, the edges are looked at."""
    line_sigma: float = 0.0025
    """How well a line through the boundary is known where it meets another."""
    template_sigma: float = 0.004
    """How well the template's proportions hold from one corner to its neighbours."""
    smoothed: float = 0.0015
    """What segmentation takes off a very acute corner."""
    normal_reach: float = 0.05
    body: BodySettings = field(default_factory=BodySettings)


def set_corners(
    X: Array,
    feature: NDArray[np.intp],
    polygon: Array,
    boundary: Boundary,
    settings: CornerSettings | None = None,
) -> Array:
    """The registered contour X (n, 2) [m] with its feature points, feature (n,) >= 0, set anew.

    polygon: (k, 2) the template, counter-clockwise, feature's numbers being its vertices.

    Straight lines through the boundary on both sides say where the edges meet. A sewn corner is round, and its tip
    lies where the boundary comes nearest to that. Only between two legs, where the table is too narrow to be seen
    near the crotch, it is where the edges meet; as they do so at an acute angle, the template has a say.
    """
    settings = settings or CornerSettings()
    moved = X.copy()
    corners = np.flatnonzero(feature >= 0)
    angles = interior_angles(polygon)[feature[corners]]
    clear = np.sin(angles) ** 2
    shape = polygon[feature[corners]]
    q, normals = boundary.points[::2], boundary.normals[::2]
    segment, t, _ = closest_segments(X, q, normals, settings.normal_reach)
    along, at = _arc_position(X, segment, t), _arc_position(X, corners, np.zeros(len(corners)))
    total = float(segment_lengths(X).sum())
    blunt = (angles <= settings.notch_angle) & (np.abs(np.sin(angles)) < settings.sharp)
    body = lay_body(shape, X[corners], clear > 0.5, boundary, settings.body) if blunt.any() else None
    for k, vertex in enumerate(corners):
        if blunt[k]:
            # Two opinions of one place, about equally good, whose errors have little to do with each other.
            between = X[vertex] if body is None else 0.5 * (X[vertex] + body[k])
            moved[vertex] = boundary.points[boundary.nearest(between[None])[1][0]]
            continue
        notch = bool(angles[k] > settings.notch_angle)
        lines = _edges(k, at, total, q, along, settings.notch_edge if notch else settings.edge)
        if len(lines) < 2:
            continue
        if notch:
            tip = _most_likely(lines, _by_template(k, shape, X[corners], clear), settings)
        else:
            meeting = _meet(lines)
            tip = X[vertex] if meeting is None else _round_tip(meeting, lines, angles[k], boundary, settings)
        if np.linalg.norm(tip - X[vertex]) <= (settings.notch if notch else settings.snap):
            moved[vertex] = tip
    return moved


def least_turn(corners: Array, angles: Array, boundary: Boundary, settings: CornerSettings | None = None) -> float:
    """How much of a sharp corner's angle the boundary turns by where that corner was set: the least share.

    corners: (k, 2) [m]; angles: (k,) the template's interior ones [rad]. A corner of which the boundary shows
    nothing (share near 0) was set somewhere along an edge. Notches are left out: nobody sees into them.
    """
    settings = settings or CornerSettings()
    sharp = (np.abs(np.sin(angles)) >= settings.sharp) & (angles <= settings.notch_angle)
    if not sharp.any():
        return 1.0
    n, points = len(boundary.points), boundary.points
    near, far = _TIP, 3 * _TIP
    at = boundary.nearest(corners[sharp])[1]
    # The corner may be set a little beside the tip, and rounded: the chords begin beside it.
    shares = []
    for offset in (-near, 0, near):
        i = at + offset
        coming = points[(i - near) % n] - points[(i - far) % n]
        going = points[(i + far) % n] - points[(i + near) % n]
        cross = coming[:, 0] * going[:, 1] - coming[:, 1] * going[:, 0]
        turn = np.arctan2(cross, (coming * going).sum(axis=1))
        shares.append(turn / (np.pi - angles[sharp]))
    return float(np.max(shares, axis=0).min())


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


def _most_likely(lines: list[tuple[Array, Array]], wanted: Array, settings: CornerSettings) -> Array:
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


def _round_tip(
    corner: Array, lines: list[tuple[Array, Array]], angle: float, boundary: Boundary, settings: CornerSettings
) -> Array:
    """The tip of a round corner: how far the boundary reaches there along the bisector of its edges, less what
    smoothing the picture took off it."""
    _, nearest = boundary.nearest(corner[None])
    near = boundary.points[(nearest[0] + np.arange(-_TIP, _TIP + 1)) % len(boundary.points)]
    away = sum(_towards(corner, point, u) for point, u in lines)
    tip = near[int(np.argmax(near @ away))]
    missing = corner - tip
    far = float(np.linalg.norm(missing))
    cut = settings.smoothed * abs(float(np.cos(0.5 * angle)))
    return np.asarray(tip + missing * min(1.0, cut / max(far, 1e-9)))


def _towards(corner: Array, point: Array, direction: Array) -> Array:
    """The unit vector along a line through `point` that leads to the corner."""
    return direction * np.sign(float(direction @ (corner - point)))


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
