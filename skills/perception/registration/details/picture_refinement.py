"""Moves key points of a registered contour to details that only the picture shows.

A notch, such as a crotch, and a hollow corner, such as the armpit of a shirt, move to the end of the gap between
the two pieces of cloth (`gap_end`), because the segmented boundary ends before it. A shoulder moves to the end of
the sleeve's seam (`sleeve_seam`), because the outline hardly bends there. Where the picture does not show such a
detail, the key point stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array, frozen
from foldcell.skills.perception.outline import GarmentOutline, interior_angles, polygon_area
from foldcell.skills.perception.registration.corners import HOLLOW_ANGLE, NOTCH_ANGLE, ROUND_END
from foldcell.skills.perception.registration.details.cloth_picture import ClothPicture
from foldcell.skills.perception.registration.details.gap_end import HOLLOW, NARROW, locate_gap_end
from foldcell.skills.perception.registration.details.sleeve_seam import locate_seams
from foldcell.skills.perception.registration.details.upper_edge import locate_upper_edge
from foldcell.skills.perception.registration.energy import Boundary
from foldcell.skills.perception.registration.register import Registration

_Places = Mapping[str, tuple[Array, float]]
"""Name of a key point -> its place (2,) and standard deviation [m]."""

_HOLLOW_EDGE = 0.08
"""Least length of the edges of a hollow corner [m, for a garment of its nominal size]. Shorter ones, as the
underarm seam of many T-shirts, leave a wide gap, and the outline shows its end."""
_LEG_GROWTH = 0.12
"""Least expected growth of the width of a gap, per length, because legs can touch in a template."""
_UNSEEN_SIGMA = 0.020
"""Standard deviation of the place of a gap's end that the picture does not show [m]."""
_CROTCH_SIGMA, _ARMPIT_SIGMA = 0.080, 0.020
"""The same if the template does not show where the gap ends [m, for a garment of its nominal size]: of a crotch,
and of an armpit, which is the end of a wider gap."""


def refine_by_picture(
    registration: Registration,
    garment: GarmentOutline,
    contour: Array,
    picture: ClothPicture,
    shape_known: bool = True,
) -> Registration:
    """Return the registration with its notches and shoulders moved, as far as the picture shows them.

    garment: with its limbs as in its template and not swung, because a notch is recognised by legs that lie close
    together in the template. contour: (n, 2) observed boundary [m]. shape_known: whether the template shows where
    shoulders and collar are; otherwise the outline's upper edge does.
    """
    # The search for a seam ends at the armpit where the outline puts it, because this place is near the end of the
    # seam.
    outlined, boundary, sides = registration.keypoints, Boundary(contour), _sides(garment)
    registration = _set_notches(registration, garment, picture, shape_known)
    if len(sides) != 2:
        return registration
    if not shape_known:
        located = locate_upper_edge(registration.keypoints, boundary.points, (sides[0], sides[1]), picture)
        registration = _all_moved(registration, located)
    names = [f"shoulder_{side}" for side in sides]
    shoulders = [(registration.keypoints[name], registration.sigmas[name]) for name in names]
    armpits, hem = (np.array([outlined[f"{n}_{side}"] for side in sides]) for n in ("armpit", "hem"))
    up = (armpits - hem).mean(axis=0)
    seams = locate_seams(picture, boundary, shoulders, armpits, up / np.linalg.norm(up))
    registration = _all_moved(registration, dict(zip(names, seams, strict=True)))
    if shape_known:
        return registration
    # The places of the seams tell the ends of the collar, too.
    located = locate_upper_edge(registration.keypoints, boundary.points, (sides[0], sides[1]), picture, seams)
    return _all_moved(registration, {name: place for name, place in located.items() if name not in names})


def _all_moved(registration: Registration, places: _Places) -> Registration:
    for name, (place, sigma) in places.items():
        registration = _moved(registration, name, place, sigma)
    return registration


def notches(registration: Registration, garment: GarmentOutline) -> tuple[str, ...]:
    """Return the names of the key points at the end of a gap between two limbs, or between a limb and the body.

    A notch of the template is a notch in any pose. A limb that lies close to the body, such as a lowered sleeve,
    makes a further notch. A round end is none, however deep.
    """
    lying = np.array([registration.keypoints[name] for name in garment.keypoints])
    angles = np.maximum(_interior_angles(np.asarray(garment.template, dtype=float)), _interior_angles(lying))
    return tuple(
        garment.keypoints[k] for k in np.flatnonzero(angles > NOTCH_ANGLE) if garment.keypoints[k] != ROUND_END
    )


def _set_notches(
    registration: Registration, garment: GarmentOutline, picture: ClothPicture, shape_known: bool
) -> Registration:
    names, places, scale = garment.keypoints, registration.keypoints, registration.scale
    narrow = notches(registration, garment)
    lying = _interior_angles(np.array([places[name] for name in names]))
    sleeved = [name for name in names if name.replace("armpit_", "cuff_lower_") in set(names) - {name}]
    hollow = [name for name in sleeved if lying[names.index(name)] > HOLLOW_ANGLE]
    for name in dict.fromkeys((*narrow, *hollow)):
        k = names.index(name)
        first, second = places[names[k - 1]], places[names[(k + 1) % len(names)]]
        opening = _between(places[name], first, second)
        growth = max(2.0 * float(np.tan(0.5 * (2.0 * np.pi - lying[k]))), _LEG_GROWTH)
        settings = NARROW if name in narrow else HOLLOW
        end = locate_gap_end(picture, places[name], opening, growth, settings, scale)
        if end is not None:
            registration = _moved(registration, name, *end)
        elif (
            name in narrow or min(np.linalg.norm(p - places[name]) for p in (first, second)) > _HOLLOW_EDGE * scale
        ):
            unknown = _ARMPIT_SIGMA if name in sleeved else _CROTCH_SIGMA
            unseen = _UNSEEN_SIGMA if shape_known else unknown * scale
            registration = replace(registration, sigmas={**registration.sigmas, name: unseen})
    return registration


def _sides(garment: GarmentOutline) -> list[str]:
    """Return the sides on which a garment has a sleeve with its shoulder, and a hem, in the order of its key
    points."""
    names = garment.keypoints
    sides = [n.removeprefix("cuff_upper_") for n in names if n.startswith("cuff_upper_")]
    return [side for side in sides if {f"shoulder_{side}", f"armpit_{side}", f"hem_{side}"} <= set(names)]


def _interior_angles(polygon: Array) -> NDArray[np.float64]:
    """Interior angles (n,) of a polygon (n, 2), whether it runs clockwise or not [rad]."""
    if polygon_area(polygon) > 0:
        return interior_angles(polygon)
    return interior_angles(polygon[::-1])[::-1]


def _between(notch: Array, first: Array, second: Array) -> Array:
    """Return a point (2,) in the middle of a gap. The edges of the gap run from the notch to two corners. The
    point is as far from the notch as the nearer corner."""
    length = min(float(np.linalg.norm(first - notch)), float(np.linalg.norm(second - notch)))
    first, second = (notch + length * (p - notch) / np.linalg.norm(p - notch) for p in (first, second))
    return np.asarray(0.5 * (first + second))


def _moved(registration: Registration, name: str, place: Array, sigma: float) -> Registration:
    contour = registration.contour.copy()
    contour[np.argmin(np.linalg.norm(contour - registration.keypoints[name], axis=1))] = place
    return replace(
        registration,
        keypoints={**registration.keypoints, name: frozen(place)},
        sigmas={**registration.sigmas, name: sigma},
        contour=frozen(contour),
        relocated=(*registration.relocated, name),
    )
