"""Poses of a garment's limbs. Trousers lie with the legs apart, shirts with the sleeves raised or lowered; the fit
of a template needs a start that is near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from foldcell.robots.ports import Array
from foldcell.skills.perception.classify import polygon_iou
from foldcell.skills.perception.outline import GarmentOutline, counter_clockwise, polygon_area
from foldcell.skills.perception.registration.energy import Boundary
from foldcell.skills.perception.registration.register import best_starts
from foldcell.skills.plane import rotation

__all__ = ["PosedOutline", "best_poses", "limb_tips", "posed_template"]

_TIPS = ("ankle", "cuff")
_LONG = 0.35
"""A limb is longer than this, relative to the square root of the garment's area. Shorter ones, such as the sleeves
of a T-shirt, are fitted without a start of their own."""
SWINGS = tuple(np.deg2rad((-24.0, -12.0, 0.0, 12.0, 24.0, 36.0)))
"""Swings of a limb away from the body that are tried [rad]."""
_NEEDLESS = 0.90
"""A template that overlaps by more than this without a swing is kept as it is."""


@dataclass(frozen=True, eq=False)
class PosedOutline:
    """A garment's outline with swung limbs; see `GarmentOutline`."""

    name: str
    category: str
    keypoints: tuple[str, ...]
    template: Array


def best_poses(contour: Array, garments: Sequence[GarmentOutline]) -> list[GarmentOutline]:
    """Return each garment with the swings of its limbs that fit an observed boundary (n, 2) [m] best."""
    contour = counter_clockwise(contour)
    boundary = Boundary(contour, step=0.003, sample_step=0.015)
    return [_best_pose(contour, boundary, garment) for garment in garments]


def limb_tips(garment: GarmentOutline) -> list[tuple[int, int]]:
    """Return the pairs of neighbouring key points at which the garment's long limbs end."""
    names, template = garment.keypoints, np.asarray(garment.template, dtype=float)
    size = float(np.sqrt(abs(polygon_area(template))))
    found = []
    for i, name in enumerate(names):
        j = (i + 1) % len(names)
        is_tip = any(name.startswith(tip) and names[j].startswith(tip) for tip in _TIPS)
        if is_tip and name.split("_")[-1] == names[j].split("_")[-1]:
            tip = 0.5 * (template[i] + template[j])
            if np.linalg.norm(tip - template[_pivot(template, i, j)]) > _LONG * size:
                found.append((i, j))
    return found


def posed_template(garment: GarmentOutline, swings: Sequence[float]) -> Array:
    """Return the template (k, 2) with each long limb turned away from the body about its inner root, such as the
    crotch. swings: one for each pair of `limb_tips` [rad]."""
    template = np.asarray(garment.template, dtype=float)
    posed = template.copy()
    middle = template.mean(axis=0)
    for (i, j), swing in zip(limb_tips(garment), swings, strict=True):
        root = template[_pivot(template, i, j)]
        limb = 0.5 * (template[i] + template[j]) - root
        away = 0.5 * (template[i] + template[j]) - middle
        side = away - (away @ _axis(template)) * _axis(template)
        sign = 1.0 if limb[0] * side[1] - limb[1] * side[0] > 0 else -1.0
        R = rotation(sign * swing)
        for k in (i, j):
            posed[k] = root + R @ (template[k] - root)
    return posed


def _axis(template: Array) -> Array:
    """Return the unit vector (2,) of the garment's axis of symmetry: the first and the last key point mirror each
    other across it."""
    across = template[-1] - template[0]
    return np.array([-across[1], across[0]]) / np.linalg.norm(across)


def _pivot(template: Array, i: int, j: int) -> int:
    """Return the index of the root next to the tip i, j that is nearer to it."""
    before, after = (i - 1) % len(template), (j + 1) % len(template)
    near = np.linalg.norm(template[before] - template[i]) < np.linalg.norm(template[after] - template[j])
    return before if near else after


def _best_pose(contour: Array, boundary: Boundary, garment: GarmentOutline) -> GarmentOutline:
    limbs = limb_tips(garment)
    if not limbs:
        return garment
    swings: tuple[float, ...] = (0.0,) * len(limbs)
    best = _overlap(contour, boundary, posed_template(garment, swings))
    if best > _NEEDLESS:
        return garment
    for tried in product(SWINGS, repeat=len(limbs)):
        overlap = _overlap(contour, boundary, posed_template(garment, tried))
        if overlap > best:
            best, swings = overlap, tried
    if not any(swings):
        return garment
    return PosedOutline(garment.name, garment.category, garment.keypoints, posed_template(garment, swings))


def _overlap(contour: Array, boundary: Boundary, template: Array) -> float:
    starts = best_starts(counter_clockwise(template), boundary, candidates=2)
    return max(polygon_iou(start.polygon, contour) for start in starts)
