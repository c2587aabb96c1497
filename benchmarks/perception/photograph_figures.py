"""Measures perception on `photographs`. Its input is the same as with `foldcell perceive IMAGE --unit px`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.perception.photographs import CRUMPLED, GARMENTS, Photograph, photograph
from benchmarks.shipped_settings import PERCEPTION
from foldcell.cell.hardware.photograph import photographed
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.perceive import Perception, perceive
from foldcell.skills.vocabulary import Outcome

__all__ = ["look_at", "measure_photographs", "worst_error"]

COUNT, QUICK_COUNT = 108, 9
NEAR, FAR = 0.02, 0.05
"""Limits of the largest key point error that are reported, relative to the garment's diagonal in the picture."""
SIDES = ({}, {"left": "right", "right": "left"}, {"near": "far", "far": "near"},
         {"left": "right", "right": "left", "near": "far", "far": "near"})  # fmt: skip


@dataclass(frozen=True)
class _Judged:
    category: str
    ground: str
    accepted: bool
    right: bool
    error: float


def look_at(picture: Photograph, garments: Sequence[Garment]) -> Outcome[Perception]:
    calibration, table = photographed(picture.rgb.shape)
    depth = np.full(picture.rgb.shape[:2], np.nan, np.float32)
    frame = CameraFrame(0.0, 0, picture.rgb, depth, calibration.intrinsics)
    settings = replace(PERCEPTION, depth_holes=1.0, size_known=False)
    return perceive(frame, calibration, table, None, garments, settings=settings)


def worst_error(found: Mapping[str, Array], truth: Mapping[str, Array]) -> float:
    """Return the largest key point error [px].

    Front and back of a garment look alike, so the names 'left' and 'right' may be swapped. The two ends of a towel
    look alike, so 'near' and 'far' may be swapped. The error is that of the swap with the smallest error.
    """
    errors = []
    for swapped in SIDES:
        named = {n: "_".join(swapped.get(word, word) for word in n.split("_")) for n in truth}
        if set(named.values()) <= set(found):
            errors.append(max(float(np.linalg.norm(found[named[n]] - p)) for n, p in truth.items()))
    return min(errors, default=float("inf"))


def measure_photographs(
    tell: Callable[[str], None], garments: Sequence[Garment], quick: bool
) -> Mapping[str, Any]:
    kinds = [*GARMENTS, *CRUMPLED]
    judged = []
    for seed in range(QUICK_COUNT if quick else COUNT):
        judged.append(_judge(photograph(kinds[seed % len(kinds)], seed), garments))
        if (seed + 1) % 27 == 0:
            tell(f"{seed + 1} photographs")
    flat = [j for j in judged if j.category]
    accepted = [j for j in flat if j.accepted]
    return {
        "photographs": len(flat),
        "photographs_accepted_rate": _rate(j.accepted for j in flat),
        "photographs_category_rate": _rate(j.right for j in accepted),
        "photographs_within_2_percent_rate": _rate(j.error <= NEAR for j in accepted),
        "photographs_within_5_percent_rate": _rate(j.error <= FAR for j in accepted),
        "photographs_not_flat": len(judged) - len(flat),
        "photographs_not_flat_accepted": sum(j.accepted for j in judged if not j.category),
        "photographs_of": [
            {"ground": ground, "photographs": len(some), "accepted_rate": _rate(j.accepted for j in some),
             "within_5_percent_rate": _rate(j.error <= FAR for j in some if j.accepted)}
            for ground in sorted({j.ground for j in flat})
            for some in [[j for j in flat if j.ground == ground]]
        ],
    }  # fmt: skip


def _judge(picture: Photograph, garments: Sequence[Garment]) -> _Judged:
    seen = look_at(picture, garments)
    if not seen.ok:
        return _Judged(picture.category, picture.ground, False, False, float("inf"))
    found = seen.unwrap()
    points = {name: found.view.to_image(p) for name, p in found.state.keypoints.items()}
    size = float(np.linalg.norm(np.ptp(picture.outline, axis=0)))
    right = found.state.category == picture.category
    return _Judged(
        picture.category, picture.ground, True, right, worst_error(points, picture.points) / size if right else 1.0
    )


def _rate(values: Any) -> float:
    values = list(values)
    return float(np.mean(values)) if values else 0.0
