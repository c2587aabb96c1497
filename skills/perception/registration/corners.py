"""Relocates the corners of a registered contour, as the last step of the registration.

A sharp corner moves to the tip of the boundary's corner, a crotch to the intersection of the adjoining edges. A
blunt corner has two estimates: where the registration put it, and where it is relative to the garment's body
(`body`). From their mean, it moves to the bend of the boundary (`bend`), as far as there is one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import interior_angles, polygon_area, segment_lengths
from foldcell.skills.perception.registration.bend import locate_bend
from foldcell.skills.perception.registration.body import lay_body
from foldcell.skills.perception.registration.energy import Boundary, closest_segments

NOTCH_ANGLE = 5.6
"""A corner with a larger interior angle than this is a notch between two limbs, such as a crotch [rad]."""
ROUND_END = "neck"
"""Key point at the round end of a notch, of which the outline shows all, unlike that of the gap between two legs:
the middle of a vest's neckline."""
HOLLOW_ANGLE = 4.9
"""A corner with a larger interior angle than this is hollow, as the armpit of a shirt [rad]."""
_SHARP = 0.7
"""A corner is sharp if the sine of its interior angle is at least this, otherwise blunt."""
_SNAP, _NOTCH = 0.05, 0.25
"""Maximum displacement of a sharp corner and of a notch [m]."""
_EDGE, _NOTCH_EDGE = 0.08, 0.16
"""Length of the edges to which lines are fitted, at a corner and at a notch [m]."""
_SHORT = 0.03
"""An edge that is shorter than this and has too few points is taken as straight between its corners [m]."""
_LINE_SIGMA = 0.0025
"""Standard deviation of the position of a line fitted to an edge, where it meets the other line [m]."""
_TEMPLATE_SIGMA = 0.004
"""Standard deviation of the place that the template predicts for a corner from its neighbours [m]."""
_SMOOTHED = 0.0015
"""Length that smoothing during segmentation removes from the tip of a very acute corner [m]."""
_TIP_SIGMA, _NOTCH_SIGMA, _UNMOVED_SIGMA = 0.0016, 0.010, 0.020
"""Standard deviations of the place of a sharp corner, of a notch, and of a corner that was not relocated [m]."""
_FITTED_SIGMA = 0.006
"""Standard deviation of the place of a blunt corner in a shape that was fitted to the outline [m]."""
_TIP = 8
"""Number of boundary points, before and after the nearest one, among which the tip of a corner is searched."""


def set_corners(
    X: Array,
    feature: NDArray[np.intp],
    polygon: Array,
    boundary: Boundary,
    fitted: bool = False,
    rounded: int = -1,
) -> tuple[Array, Array]:
    """Return the registered contour X (n, 2) [m] with its corners relocated, and the standard deviation of the
    place of each corner (c,), in the order of the contour [m].

    polygon: (k, 2) the template, counter-clockwise. feature: (n,) index into `polygon` of each contour point that
    is a corner, -1 for the other points. fitted: whether the template was made for this outline; its blunt corners
    then stay where they are on the boundary. rounded: index into `polygon` of a corner that is blunt although the
    edges from the neighbouring ones are steep.

    Straight lines are fitted to the edges on both sides of a corner. A sewn corner is round: its tip is the
    boundary point that reaches furthest towards the intersection of the lines. Near a crotch the table between the
    trouser legs is too narrow to be visible, so the intersection itself is used. Because the edges meet there at
    an acute angle, the intersection is uncertain, so the template serves as a prior.
    """
    moved = X.copy()
    corners = np.flatnonzero(feature >= 0)
    sigma = np.full(len(corners), _UNMOVED_SIGMA)
    angles = interior_angles(polygon)[feature[corners]]
    clear = np.sin(angles) ** 2
    shape = polygon[feature[corners]]
    q, normals = boundary.points[::2], boundary.normals[::2]
    segment, t, _ = closest_segments(X, q, normals)
    point_arc, corner_arc = _arc_position(X, segment, t), _arc_position(X, corners, np.zeros(len(corners)))
    total = float(segment_lengths(X).sum())
    blunt = (angles <= NOTCH_ANGLE) & (np.abs(np.sin(angles)) < _SHARP) | (feature[corners] == rounded)
    body = lay_body(shape, X[corners], clear > 0.5, boundary) if blunt.any() and not fitted else None
    for k, vertex in enumerate(corners):
        if blunt[k] and fitted:
            moved[vertex], sigma[k] = boundary.points[boundary.nearest(X[vertex][None])[1][0]], _FITTED_SIGMA
            continue
        if blunt[k]:
            # The two estimates have about equal and nearly independent errors, so their mean is used.
            place = X[vertex] if body is None else 0.5 * (X[vertex] + body[k])
            gaps = (corner_arc[k] - corner_arc[k - 1], corner_arc[(k + 1) % len(corners)] - corner_arc[k])
            before, after = (gap % total for gap in gaps)
            moved[vertex], sigma[k] = locate_bend(boundary, place, before, after, np.pi - angles[k])
            continue
        notch = bool(angles[k] > NOTCH_ANGLE)
        lines = _edge_lines(k, X[corners], corner_arc, total, q, point_arc, _NOTCH_EDGE if notch else _EDGE)
        if len(lines) < 2:
            continue
        if notch:
            tip = _map_estimate(lines, _by_template(k, shape, X[corners], clear))
            if fitted:
                first, last = k - 1, (k + 1) % len(corners)
                inside = (point_arc - corner_arc[first]) % total < (corner_arc[last] - corner_arc[first]) % total
                tip = _seen_end(tip, 0.5 * (X[corners[first]] + X[corners[last]]), q[inside])
        else:
            meeting = _intersection(lines)
            tip = X[vertex] if meeting is None else _rounded_corner_tip(meeting, lines, angles[k], boundary)
        if np.linalg.norm(tip - X[vertex]) <= (_NOTCH if notch else _SNAP):
            moved[vertex] = tip
            sigma[k] = _NOTCH_SIGMA if notch else _TIP_SIGMA
    return moved, sigma


def least_turn(corners: Array, angles: Array, boundary: Boundary) -> tuple[float, int]:
    """Compute how much the boundary turns at the place of a sharp corner, relative to the turn of this corner in
    the template. Return the smallest ratio over all sharp corners, and the index of this corner.

    corners: (k, 2) [m]. angles: (k,) interior angles of the template [rad]. A ratio near 0 means that the corner
    was placed on a straight part of the boundary. Notches are ignored, because their inside is not visible. So are
    corners whose turn cannot be told from that of the next one.
    """
    edges = segment_lengths(corners)
    alone = np.minimum(edges, np.roll(edges, 1)) > boundary.length / len(boundary.points) * 3 * _TIP
    sharp = (np.abs(np.sin(angles)) >= _SHARP) & (angles <= NOTCH_ANGLE) & alone
    if not sharp.any():
        return 1.0, 0
    n, points = len(boundary.points), boundary.points
    near, far = _TIP, 3 * _TIP
    nearest_index = boundary.nearest(corners[sharp])[1]
    # The corner may be round and a little displaced, so the chords whose angle is measured start beside it.
    shares = []
    for offset in (-near, 0, near):
        i = nearest_index + offset
        incoming = points[(i - near) % n] - points[(i - far) % n]
        outgoing = points[(i + far) % n] - points[(i + near) % n]
        cross = incoming[:, 0] * outgoing[:, 1] - incoming[:, 1] * outgoing[:, 0]
        turn = np.arctan2(cross, (incoming * outgoing).sum(axis=1))
        shares.append(turn / (np.pi - angles[sharp]))
    share = np.max(shares, axis=0)
    return float(share.min()), int(np.flatnonzero(sharp)[np.argmin(share)])


def _edge_lines(
    k: int, X: Array, corner_arc: Array, total: float, q: Array, point_arc: Array, reach: float
) -> list[tuple[Array, Array]]:
    """Fit lines (point, unit direction) to the boundary on both sides of the k-th corner, up to `reach` [m] from
    it.

    X: (c, 2) the corners. corner_arc: (c,) positions of the corners along the contour; point_arc: (m,) positions
    of the boundary's points q (m, 2) along it; total: length of the contour; all [m].
    """
    lines = []
    for sign, other in ((-1.0, corner_arc[k - 1]), (1.0, corner_arc[(k + 1) % len(corner_arc)])):
        span = (sign * (other - corner_arc[k])) % total
        distance = (sign * (point_arc - corner_arc[k])) % total
        chosen = (distance > min(0.014, 0.25 * span)) & (distance < min(0.55 * span, reach))
        line = _line(q[chosen])
        if line is None and span < _SHORT:
            line = X[k], (X[k + int(sign) - len(X)] - X[k]) / max(span, 1e-6)
        if line is not None:
            lines.append(line)
    return lines


def _by_template(k: int, shape: Array, placed: Array, clear: Array) -> Array:
    """Predict the place (2,) of the k-th corner from the other corners: `shape` (n, 2), scaled to the same area,
    is moved rigidly onto `placed` (n, 2). Corners near the k-th one count more.

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


def _map_estimate(lines: list[tuple[Array, Array]], prior: Array) -> Array:
    """Compute the maximum a posteriori estimate (2,) of the intersection of two lines, given a prior place.
    Standard deviations: `_LINE_SIGMA` for a line, `_TEMPLATE_SIGMA` for the prior."""
    A, b = np.eye(2) / _TEMPLATE_SIGMA**2, prior / _TEMPLATE_SIGMA**2
    for point, direction in lines:
        normal = np.array([-direction[1], direction[0]])
        A = A + np.outer(normal, normal) / _LINE_SIGMA**2
        b = b + normal * float(normal @ point) / _LINE_SIGMA**2
    return np.asarray(np.linalg.solve(A, b))


def _intersection(lines: list[tuple[Array, Array]]) -> Array | None:
    (a, u), (b, v) = lines
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) < 0.25:
        return None
    d = b - a
    return np.asarray(a + u * (d[0] * v[1] - d[1] * v[0]) / cross)


def _rounded_corner_tip(
    corner: Array, lines: list[tuple[Array, Array]], angle: float, boundary: Boundary
) -> Array:
    """Find the tip (2,) of a round corner: the boundary point that is furthest along the bisector of the edges,
    corrected for the length that the smoothing of the picture removed. corner: (2,) intersection of the edges."""
    _, nearest = boundary.nearest(corner[None])
    near = boundary.points[(nearest[0] + np.arange(-_TIP, _TIP + 1)) % len(boundary.points)]
    outwards = sum(_towards(corner, point, u) for point, u in lines)
    tip = near[int(np.argmax(near @ outwards))]
    missing = corner - tip
    missing_length = float(np.linalg.norm(missing))
    removed = _SMOOTHED * abs(float(np.cos(0.5 * angle)))
    return np.asarray(tip + missing * min(1.0, removed / max(missing_length, 1e-9)))


def _seen_end(tip: Array, opening: Array, seen: Array) -> Array:
    """Return the end (2,) of a gap: the tip (2,), or of the boundary points `seen` (n, 2) in the gap the one that
    lies furthest from its opening (2,), if that is further. Between flared legs, the gap goes on beyond the place
    where the lines meet."""
    depths = (seen - opening) @ (tip - opening)
    return seen[np.argmax(depths)] if len(seen) and depths.max() > (tip - opening) @ (tip - opening) else tip


def _towards(corner: Array, point: Array, direction: Array) -> Array:
    """Return the unit vector along a line through `point` that points towards the corner."""
    return direction * np.sign(float(direction @ (corner - point)))


def _arc_position(X: Array, segment: NDArray[np.intp], t: Array) -> Array:
    lengths = segment_lengths(X)
    start = np.r_[0.0, np.cumsum(lengths)[:-1]]
    return start[segment] + t * lengths[segment]


def _line(points: Array) -> tuple[Array, Array] | None:
    """Fit a total least-squares line (point, unit direction), and fit it again without the worst fifth of the
    points; None for too few points."""
    if len(points) < 4:  # on a short edge, as the strap of a vest, few points are left
        return None
    for _ in range(2):
        middle = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
        distance = np.abs((points - middle) @ np.array([-axes[0, 1], axes[0, 0]]))
        points = points[distance <= np.quantile(distance, 0.8) + 1e-9]
    return middle, axes[0]
