"""Moves the notches of a registered contour, such as a crotch, to the end of the gap that the picture shows.

The registration places a notch by the edges of the two limbs and by the template. The picture shows the gap
between the limbs nearer to its end than the segmented boundary does. Both estimates are combined by their
covariances. The more they differ, the less the first one counts, because legs have other proportions than those of
the template.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robots.ports import Array, frozen
from skills.perception.registration.corners import CornerSettings
from skills.perception.registration.energy import interior_angles
from skills.perception.registration.leg_gap import ClothPicture, GapEnd, locate_gap_end
from skills.perception.registration.register import Registration
from skills.perception.template import GarmentOutline, polygon_area

__all__ = ["set_notches"]

_BY_EDGES = 0.010
"""Standard deviation of the registration's place of a notch along the gap [m]."""
_ASIDE = 0.004
"""The same across the gap [m]."""


def set_notches(registration: Registration, garment: GarmentOutline, picture: ClothPicture) -> Registration:
    """Return the registration with its notches moved, as far as the picture shows the gaps.

    garment: with its limbs as in its template, not swung: legs lie close together there, by which notches are
    known.
    """
    template = np.asarray(garment.template, dtype=float)
    angles = interior_angles(template if polygon_area(template) > 0 else template[::-1])
    angles = angles if polygon_area(template) > 0 else angles[::-1]
    names, places = garment.keypoints, registration.keypoints
    for k in np.flatnonzero(angles > CornerSettings().notch_angle):
        name, beside = names[k], (names[k - 1], names[(k + 1) % len(names)])
        opening = 0.5 * (places[beside[0]] + places[beside[1]])
        end = locate_gap_end(picture, places[name], opening)
        if end is not None:
            registration = _moved(registration, name, _combined(places[name], opening, end))
    return registration


def _combined(place: Array, opening: Array, end: GapEnd) -> Array:
    """Combine the registration's place (2,) of a notch and the end of the gap."""
    along = (opening - place) / np.linalg.norm(opening - place)
    across = np.array([-along[1], along[0]])
    away = end.place - place
    variances = _BY_EDGES**2 + float(away @ along) ** 2, _ASIDE**2 + float(away @ across) ** 2
    weight = np.outer(along, along) / variances[0] + np.outer(across, across) / variances[1]
    seen = np.linalg.inv(end.covariance)
    return np.asarray(np.linalg.solve(weight + seen, weight @ place + seen @ end.place))


def _moved(registration: Registration, name: str, place: Array) -> Registration:
    contour = registration.contour.copy()
    contour[np.argmin(np.linalg.norm(contour - registration.keypoints[name], axis=1))] = place
    return replace(
        registration,
        keypoints={**registration.keypoints, name: frozen(place)},
        contour=frozen(contour),
    )
