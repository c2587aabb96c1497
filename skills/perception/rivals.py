"""Compares the categories that an outline may belong to, when no garment is named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.classify import Match, classify
from foldcell.skills.perception.family import best_members, likely_members
from foldcell.skills.perception.outline import (
    GarmentOutline,
    MemberOutline,
    counter_clockwise,
    interior_angles,
    polygon_area,
)
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.perception.registration.energy import Boundary
from foldcell.skills.perception.registration.register import best_starts
from foldcell.skills.vocabulary import Failure, FailureKind

FITTED = 2.0
"""Categories are fitted whose starts are at most this many times as far from the outline as the nearest."""
STRAIN_COST, FREEDOM_COST = 0.1, 0.03
"""The likeness is the overlap, less the strain of a member times the first, and less the second, because a member
follows any outline better than a stiff template does."""
INWARD, LEAST_DEPTH = 0.35, 0.10
"""A garment with an inward corner, of at least the first [rad], has an outline that lies at some place deeper
within its convex hull than the second, relative to the root of its area; others have not. Without this, a vest
would resemble any skirt, because nothing that is seen contradicts it."""


@dataclass(frozen=True)
class SecondBest:
    """The garment of another category that resembles the silhouette next. behind: how much less [likeness]."""

    garment: str
    category: str
    behind: float


def likeness(match: Match) -> float:
    """Return the overlap of a garment with a region, less for unusual figures."""
    member = match.garment if isinstance(match.garment, MemberOutline) else None
    return match.iou - (FREEDOM_COST + STRAIN_COST * member.strain if member is not None else 0.0)


def likely_matches(contour: Array, garments: Sequence[GarmentOutline], named: bool) -> tuple[Match, ...]:
    """Compare an observed boundary (n, 2) [m] with garments of any size and shape, best first. named: whether they
    are the expected ones; otherwise, only one of each category is compared, and only the likeliest are shaped. A
    category with armpits or a crotch is then left out where the outline has none, and the others where it has."""
    if named:
        return classify(contour, best_members(contour, garments))
    nominal: dict[str, Match] = {}
    for match in sorted(classify(contour, garments), key=lambda m: -m.iou):
        nominal.setdefault(match.garment.category, match)
    inward = _inward_depth(contour) > LEAST_DEPTH
    seen = {name: match for name, match in nominal.items() if _has_inward_corner(match.garment) == inward}
    shaped = likely_members(contour, [match.garment for match in seen.values()], FITTED)
    better = {match.garment.category: match for match in classify(contour, shaped)}
    return tuple(sorted({**seen, **better}.values(), key=likeness, reverse=True))


def _has_inward_corner(garment: GarmentOutline) -> bool:
    """Whether a garment has armpits, a crotch or a deep neckline."""
    return bool(interior_angles(counter_clockwise(garment.template)).max() > np.pi + INWARD)


def _inward_depth(contour: Array) -> float:
    """Return the largest distance of a boundary (n, 2) from its convex hull, relative to the root of its area."""
    points = contour.astype(np.float32)
    hull = cv2.convexHull(points)
    deepest = max(cv2.pointPolygonTest(hull, (float(x), float(y)), measureDist=True) for x, y in points)
    return float(deepest / np.sqrt(cv2.contourArea(points)))


def second_best(matches: Sequence[Match], chosen: Match) -> SecondBest | None:
    """Return what resembles the silhouette next; None if only one category was compared."""
    others = [match for match in matches if match.garment.category != chosen.garment.category]
    if not others:
        return None
    other = max(others, key=likeness)
    return SecondBest(other.garment.name, other.garment.category, likeness(chosen) - likeness(other))


def either(first: Match, second: Match) -> Failure:
    """Return the refusal of a garment that could as well be of another category."""
    names = first.garment.name, second.garment.name
    what = f"the silhouette is that of {names[0]} (overlap {first.iou:.2f}) or of {names[1]} ({second.iou:.2f})"
    values = {"best": names[0], "best_iou": first.iou, "second": names[1], "second_iou": second.iou}
    return Failure(FailureKind.UNKNOWN_GARMENT, what, "name the garment", values)


def places_of(garment: GarmentOutline, contour: Array) -> Mapping[str, Array]:
    """Return where the key points of a garment are expected on an observed boundary (n, 2) [m]: name -> (2,)."""
    if isinstance(garment, MemberOutline):
        return {garment.keypoints[k]: garment.placed[i] for i, k in enumerate(garment.feature) if k >= 0}
    polygon = counter_clockwise(garment.template)
    names = garment.keypoints[::-1] if polygon_area(garment.template) < 0 else garment.keypoints
    return dict(zip(names, best_starts(polygon, Boundary(counter_clockwise(contour)), 1)[0].polygon, strict=True))


def astray(places: Mapping[str, Array], contour: Array, view: TableView) -> str:
    """Return the name of the place (2,) [m] that is furthest outside the view or, if all lie inside, from an
    observed boundary (n, 2) [m]."""
    boundary, (rows, columns) = Boundary(contour), view.shape
    pixels = view.to_pixel(np.array([*places.values()]))
    outside = np.maximum(-pixels, pixels - (columns - 1, rows - 1)).max(axis=1)
    away = np.where(outside > 0.0, 1e3 * outside, boundary.nearest(np.array([*places.values()]))[0])
    return [*places][int(np.argmax(away))]
