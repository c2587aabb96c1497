"""Finds the place of a garment's flat outline from a silhouette in which only some parts of the garment still lie
flat. It is the place at which the flat outline agrees with most of the silhouette's boundary. Also finds the
corners of a silhouette.

Nothing is assumed about the other parts. Two corners of the silhouette that are as far apart as two corners of the
flat garment suggest a place; the place at which the longest part of the boundaries coincides is taken.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from foldcell.skills.perception.outline import counter_clockwise, resample_closed
from foldcell.skills.plane import rotation
from foldcell.skills.vocabulary import Array, Corner, frozen

STRAIGHT = 0.010
"""The boundary between two corners deviates from a straight line by less than this [m]: wrinkles and the rounding
of sewn corners are smaller."""
LEAST_EDGE = 0.030
"""A corner has an edge of at least this length on both sides [m]: two pads have to fit on it."""
SHARPEST_BEND = np.deg2rad(140.0)
"""A place of the outline is a corner if its interior angle is smaller than this. Corners of garments have 60 to
120 degrees; a bend that a ruck makes in an edge is blunter."""
SAME_LENGTH = 0.012
"""Two corners may be those of the flat garment if their distance agrees within this [m]: the corners of a
silhouette and of the flat outline are each known to about 5 mm."""
MOST_RUCKED = 0.035
"""They may also be nearer to each other by this, because of a ruck between them [m]."""
COINCIDES = 0.010
"""Boundaries that lie nearer to each other than this coincide [m]."""
FURTHEST, MOST_TURNED = 0.40, np.deg2rad(60.0)
"""Largest displacement [m] and turn [rad] of the garment as a whole. If a garment with symmetries turned further,
its orientation would be ambiguous."""
UNMOVED = 0.03
"""The garment's earlier place is preferred, unless the share of the boundary that another place explains is larger
by at least this."""
STEP = 0.005


@dataclass(frozen=True, eq=False)
class Placement:
    """A place of the flat garment: p -> R p + t moves it there from where it lay before. share: share of its
    boundary that coincides with the boundary of the silhouette."""

    R: Array
    t: Array
    share: float

    def of(self, points: Array) -> Array:
        """Return points (n, 2) of the garment as it lay before, at this place [m]."""
        return np.asarray(points) @ self.R.T + self.t


def convex_corners(contour: Array) -> tuple[Corner, ...]:
    """Return the convex corners of an outline (n, 2) [m], counter-clockwise."""
    fine = np.round(counter_clockwise(contour) * 1e4).astype(np.int32)[:, None]
    polygon = cv2.approxPolyDP(fine, STRAIGHT * 1e4, True)[:, 0] / 1e4
    if len(polygon) < 3:
        return ()
    found = []
    for before, point, after in zip(np.roll(polygon, 1, 0), polygon, np.roll(polygon, -1, 0), strict=True):
        u, v = before - point, after - point
        lengths = np.linalg.norm(u), np.linalg.norm(v)
        angle = np.arctan2(v[0] * u[1] - v[1] * u[0], u @ v) % (2.0 * np.pi)
        if angle < SHARPEST_BEND and min(lengths) >= LEAST_EDGE:
            bisector = u / lengths[0] + v / lengths[1]
            found.append(Corner(frozen(point), frozen(bisector / np.linalg.norm(bisector))))
    return tuple(found)


def place_outline(
    contour: Array,
    corners: Sequence[Corner],
    flat: Array,
    flat_corners: Sequence[Corner],
    possible: Callable[[Array], bool] = lambda outline: True,
) -> Placement:
    """Return the place of the flat outline (m, 2) at which most of its boundary coincides with a silhouette's
    contour (n, 2) [m].

    corners: of the contour; flat_corners: of the flat outline. possible: whether the flat outline (m, 2) may lie
    at a place. Without a better place, it is where the garment lay.
    """
    boundary = cKDTree(resample_closed(np.asarray(contour), STEP))
    samples = resample_closed(np.asarray(flat), STEP)

    def share(R: Array, t: Array) -> float:
        distance, _ = boundary.query(samples @ R.T + t, distance_upper_bound=COINCIDES)
        return float(np.isfinite(distance).mean())

    best = Placement(np.eye(2), np.zeros(2), share(np.eye(2), np.zeros(2)))
    least = best.share + UNMOVED
    middle = samples.mean(axis=0)
    for (p, q), (a, b) in itertools.product(
        itertools.permutations(corners, 2), itertools.combinations(flat_corners, 2)
    ):
        seen, lay = q.point - p.point, b.point - a.point
        if not -MOST_RUCKED <= np.linalg.norm(seen) - np.linalg.norm(lay) <= SAME_LENGTH:
            continue
        turn = np.arctan2(lay[0] * seen[1] - lay[1] * seen[0], lay @ seen)
        R = rotation(turn)
        t = 0.5 * (p.point + q.point) - R @ (0.5 * (a.point + b.point))
        if abs(turn) > MOST_TURNED or np.linalg.norm(R @ middle + t - middle) > FURTHEST:
            continue
        found = share(R, t)
        if found > max(least, best.share) and possible(samples @ R.T + t):
            best = Placement(frozen(R), frozen(t), found)
    return best
