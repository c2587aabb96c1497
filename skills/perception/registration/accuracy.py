"""Estimates how accurate the key points are, from the picture at hand.

The place of each key point has a standard deviation, which depends on how it was found. A sharp corner is certain.
The certainty of a blunt corner grows with the bend of the outline, and that of a crotch with the visible part of
its gap. Where the segmentation is wrong, as in a stripe of the table's colour, the boundary is rough. The
roughness near a key point, times a factor, adds to its standard deviation. Errors relative to the standard
deviation follow Student's t-distribution, because a few of them are large; they are taken as independent.

The two factors were fitted by maximum likelihood to pictures of two independent generators: 209 photographs
(`benchmarks.photographs`, seeds 7001 to 7214) and 165 scenes (`benchmarks.perception`, seeds 0 to 164).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import expit, logit, stdtr

from foldcell.robots.ports import Array
from foldcell.skills.perception.outline import (
    GarmentOutline,
    MemberOutline,
    counter_clockwise,
    interior_angles,
    polygon_area,
    smooth_closed,
)
from foldcell.skills.perception.registration.details.picture_refinement import notches
from foldcell.skills.perception.registration.energy import Boundary
from foldcell.skills.perception.registration.register import Registration

_FREEDOM = 4.0
"""Degrees of freedom of the t-distribution."""
_BY_PLACE, _BY_ROUGHNESS = 0.5, 3.5
"""Scale of the t-distribution per standard deviation of a place, and per roughness of the boundary."""
_SMOOTH = 0.008
"""Standard deviation of the Gaussian that smooths the boundary [m]. The roughness is the root mean square distance
of the boundary from the smooth one."""
_NEAR = (0.015, 0.060)
"""Distances from a key point [m, for a garment of its nominal size]. The roughness is measured up to the second
distance from the key point. Places within the first distance of any key point are excluded, because corners are
not smooth."""

_SHAPE, _HOLLOW_SHAPE, _HOLLOW = 0.002, 0.004, 0.3
"""Further scale of the errors in a shape that was fitted, relative to the garment's diagonal, because a family
does not hold all garments; the same at an inward corner, of at least the third [rad], whose end is often
hidden."""
_DOUBT = 0.8
"""Subtracted from the logarithm of the odds in photographs of unknown scale, because the scales of the errors miss
what a segmentation leaves out. Fitted to 99 flat garments of the right kind (`benchmarks.photographs`, real seeds
9560 to 9719, phone seeds 61 to 120); a factor of the logarithm came out as 1.01. Left out one at a time, the
calibration error of those above 0.5 is 0.05; in fresh pictures it was 0.13 (real) and 0.10 (phone)."""


def keypoint_sigmas(registration: Registration, garment: GarmentOutline, contour: Array) -> Mapping[str, float]:
    """Compute the scale of each key point's error: name -> [m]. contour: (n, 2) observed boundary [m]."""
    boundary = Boundary(contour)
    step = boundary.length / len(boundary.points)
    size = registration.scale
    away = np.linalg.norm(boundary.points - smooth_closed(boundary.points, size * _SMOOTH / step), axis=1)
    from_all = np.array([np.linalg.norm(boundary.points - p, axis=1) for p in registration.keypoints.values()])
    between_corners = from_all.min(axis=0) > size * _NEAR[0]
    hidden = (*notches(registration, garment), *registration.relocated)
    sigmas = {}
    for name, distance in zip(registration.keypoints, from_all, strict=True):
        near = between_corners & (distance < size * _NEAR[1])
        # The boundary does not show the end of a gap, and key points that were located in the picture or by
        # the whole upper edge do not depend on it. Its roughness therefore does not count for them.
        rough = 0.0 if name in hidden or not near.any() else float(np.sqrt(np.mean(away[near] ** 2)))
        sigmas[name] = float(np.hypot(_BY_PLACE * registration.sigmas[name], _BY_ROUGHNESS * rough))
    return sigmas


def with_shape(sigmas: Mapping[str, float], garment: MemberOutline, diagonal: float) -> Mapping[str, float]:
    """Add the error of a fitted shape to the scales of the key points' errors: name -> [m]. diagonal: of the
    garment's key points [m]."""
    names = garment.keypoints[:: 1 if polygon_area(garment.template) > 0 else -1]
    hollow = dict(zip(names, interior_angles(counter_clockwise(garment.template)) > np.pi + _HOLLOW, strict=True))
    shares = {name: _HOLLOW_SHAPE if hollow[name] else _SHAPE for name in names}
    return {name: float(np.hypot(sigma, shares[name] * diagonal)) for name, sigma in sigmas.items()}


def probability_within(sigmas: Mapping[str, float], distance: float) -> float:
    """Compute the probability that all key points lie within `distance` [m] of their true places."""
    scaled = distance / np.maximum(np.array(list(sigmas.values())), 1e-6)
    return float(np.prod(1.0 - 2.0 * stdtr(_FREEDOM, -scaled)))


def in_photograph(probability: float) -> float:
    """Compute what such a probability is worth in a photograph of unknown scale."""
    return float(expit(logit(probability) - _DOUBT))
