"""Moves key points of a registered contour to details that only the picture shows.

A notch, such as a crotch, and a hollow corner, such as the armpit of a shirt, move to the end of the gap between
the two pieces of cloth (`gap_end`), because the segmented boundary ends before it. A shoulder moves to the end of
the sleeve's seam (`sleeve_seam`), because the outline hardly bends there. Where the picture does not show such a
detail, the key point stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robots.ports import Array, frozen
from skills.perception.outline import GarmentOutline, interior_angles, polygon_area
from skills.perception.registration.corners import NOTCH_ANGLE
from skills.perception.registration.details.cloth_picture import ClothPicture
from skills.perception.registration.details.gap_end import HOLLOW, NARROW, locate_gap_end
from skills.perception.registration.details.sleeve_seam import locate_seam
from skills.perception.registration.energy import Boundary
from skills.perception.registration.register import Registration

__all__ = ["notches", "refine_by_picture"]

_HOLLOW_ANGLE = 4.9
"""A corner with a larger interior angle than this is hollow, as the armpit of a shirt [rad]."""
_HOLLOW_EDGE = 0.08
"""Least length of the edges of a hollow corner [m, for a garment of its nominal size]. Shorter ones, as the
underarm seam of many T-shirts, leave a wide gap, and the outline shows its end."""
_LEG_GROWTH = 0.12
"""Least expected growth of the width of a gap, per length, because legs can touch in a template."""
_UNSEEN_SIGMA = 0.020
"""Standard deviation of the place of a gap's end that the picture does not show [m]."""
_SEAM_SIGMA = 0.0016
"""Standard deviation of the end of a seam [m]."""


def refine_by_picture(
    registration: Registration, garment: GarmentOutline, contour: Array, picture: ClothPicture
) -> Registration:
    """Return the registration with its notches and shoulders moved, as far as the picture shows them.

    garment: with its limbs as in its template and not swung, because a notch is recognised by legs that lie close
    together in the template. contour: (n, 2) observed boundary [m].
    """
    # Shoulders are moved first. The search for a seam begins at the armpit where the outline puts it, because this
    # place is near the end of the seam.
    return _set_notches(_set_shoulders(registration, garment, contour, picture), garment, picture)


def notches(registration: Registration, garment: GarmentOutline) -> tuple[str, ...]:
    """Return the names of the key points at the end of a gap between two limbs, or between a limb and the body.

    A notch of the template is a notch in any pose. A limb that lies close to the body, such as a lowered sleeve,
    makes a further notch.
    """
    lying = np.array([registration.keypoints[name] for name in garment.keypoints])
    angles = np.maximum(_interior_angles(np.asarray(garment.template, dtype=float)), _interior_angles(lying))
    return tuple(garment.keypoints[k] for k in np.flatnonzero(angles > NOTCH_ANGLE))


def _set_notches(registration: Registration, garment: GarmentOutline, picture: ClothPicture) -> Registration:
    names, places, scale = garment.keypoints, registration.keypoints, registration.scale
    narrow = notches(registration, garment)
    lying = _interior_angles(np.array([places[name] for name in names]))
    sleeved = [name for name in names if name.replace("armpit_", "cuff_lower_") in set(names) - {name}]
    hollow = [name for name in sleeved if lying[names.index(name)] > _HOLLOW_ANGLE]
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
            registration = replace(registration, sigmas={**registration.sigmas, name: _UNSEEN_SIGMA})
    return registration


def _nearer(place: Array, first: Array, second: Array) -> float:
    return float(min(np.linalg.norm(first - place), np.linalg.norm(second - place)))


def _set_shoulders(
    registration: Registration, garment: GarmentOutline, contour: Array, picture: ClothPicture
) -> Registration:
    sides = [n.removeprefix("cuff_upper_") for n in garment.keypoints if n.startswith("cuff_upper_")]
    sides = [side for side in sides if {f"shoulder_{side}", f"armpit_{side}"} <= set(garment.keypoints)]
    if not sides:
        return registration
    boundary = Boundary(contour)
    for side in sides:
        name = f"shoulder_{side}"
        shoulder, armpit = registration.keypoints[name], registration.keypoints[f"armpit_{side}"]
        place = locate_seam(picture, boundary, shoulder, armpit)
        if place is not None:
            registration = _moved(registration, name, place, _SEAM_SIGMA)
    return registration


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
        by_picture=(*registration.by_picture, name),
    )
