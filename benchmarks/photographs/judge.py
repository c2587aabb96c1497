"""What the perception finds in drawn photographs, and whether that is good enough.

The perception is a black box here: it is called as a user calls it, with what a user can state. The limits were
set before any result was looked at.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import foldcell
from benchmarks.photographs.canvas import footprint
from benchmarks.photographs.lens import through
from benchmarks.photographs.limits import Limits, print_figures
from benchmarks.photographs.outline import Points
from benchmarks.photographs.photograph import Photograph

RIGHT_M = 0.010
"""All key points within this: right."""
FAR_M = 0.030
"""A key point beyond this: a fold would be spoilt."""
LIMITS: Limits = {
    "accepted_share": (">=", 0.95),
    "right_share_of_accepted": (">=", 0.95),
    "beyond_30_mm": ("<=", 0),
    "wrong_categories": ("<=", 0),
    "calibration_error": ("<=", 0.05),
}
BINS = 10


@dataclass(frozen=True)
class Judgement:
    """What was found in one photograph. error_m: the largest of the key points' errors, on the table; None without
    key points. found_px: the key points as the perception placed them in the picture."""

    seed: int
    category: str
    stated: bool
    known_camera: bool
    reference: bool
    accepted: bool
    found_category: str | None
    confidence: float
    error_m: float | None
    worst_keypoint: str | None
    found_px: dict[str, list[float]]
    failure: str | None
    seconds: float
    details: dict[str, Any]

    @property
    def right(self) -> bool:
        return self.found_category == self.category and self.error_m is not None and self.error_m <= RIGHT_M


def judge(photograph: Photograph) -> Judgement:
    """Show the photograph to the perception and compare what it says with the truth."""
    camera, garment = photograph.camera, photograph.garment
    settings = cell(photograph) if photograph.known_camera else None
    begun = time.perf_counter()
    seen = foldcell.perceive(
        photograph.picture,
        garment=garment.template if photograph.stated else None,
        reference=photograph.reference,
        unit="m" if photograph.known_camera else "px",
        settings=settings,
    )
    seconds = time.perf_counter() - begun
    found = {name: np.asarray(p, float)[None, :2] for name, p in seen.keypoints.items()}
    if photograph.known_camera:
        # What the perception saw is a place in the picture: the distortion, which nobody stated, is not its error.
        found = {name: through(camera.homography, p) for name, p in found.items()}
    on_table = {name: camera.on_table(p)[0] for name, p in found.items()}
    error, worst = largest_error(garment.category, garment.keypoints, on_table)
    return Judgement(
        seed=photograph.seed,
        category=garment.category,
        stated=photograph.stated,
        known_camera=photograph.known_camera,
        reference=photograph.reference is not None,
        accepted=seen.failure is None,
        found_category=seen.category,
        confidence=float(seen.confidence),
        error_m=error,
        worst_keypoint=worst,
        found_px={name: p[0].tolist() for name, p in found.items()},
        failure=None if seen.failure is None else str(seen.failure),
        seconds=seconds,
        details={"garment": garment.template, **photograph.details},
    )


def cell(photograph: Photograph) -> dict[str, Any]:
    """What a user states of the cell: where its camera is, and that the table fills the whole picture."""
    seen = footprint(photograph.camera)
    near, right = (float(v) for v in seen.min(axis=0))
    far, left = (float(v) for v in seen.max(axis=0))
    return {"camera": photograph.truth["camera"], "table": {"x": [near, far], "y": [right, left]}}


def figures(judgements: list[Judgement]) -> dict[str, float]:
    """The figures that `LIMITS` names, and the time."""
    accepted = [j for j in judgements if j.accepted]
    right = np.array([j.right for j in accepted], float)
    far = [j for j in accepted if j.error_m is not None and j.error_m > FAR_M]
    return {
        "pictures": len(judgements),
        "accepted_share": len(accepted) / len(judgements),
        "right_share_of_accepted": float(right.mean()) if accepted else 0.0,
        "beyond_30_mm": len(far),
        "wrong_categories": sum(j.found_category != j.category for j in accepted),
        "calibration_error": calibration_error(np.array([j.confidence for j in accepted]), right),
        "seconds_median": float(np.median([j.seconds for j in judgements])),
    }


def report(judgements: list[Judgement]) -> None:
    """The figures of all photographs beside their limits, and of parts of them."""
    print_figures(figures(judgements), LIMITS)
    parts = {
        "camera stated, empty table": [j for j in judgements if j.reference],
        "camera stated": [j for j in judgements if j.known_camera and not j.reference],
        "camera unknown": [j for j in judgements if not j.known_camera],
        "garment stated": [j for j in judgements if j.stated],
        "garment unknown": [j for j in judgements if not j.stated],
    }
    for category in sorted({j.category for j in judgements}):
        parts[category] = [j for j in judgements if j.category == category]
    print(f"\n{'':28}pictures  accepted  right  beyond 30 mm  wrong category")
    for name, part in parts.items():
        if part:
            f = figures(part)
            print(
                f"{name:28}{len(part):8}{f['accepted_share']:10.2f}{f['right_share_of_accepted']:7.2f}"
                f"{f['beyond_30_mm']:14.0f}{f['wrong_categories']:16.0f}"
            )


def badness(judgement: Judgement) -> tuple[int, float]:
    """For sorting: the refused ones first, then by the error."""
    if not judgement.accepted:
        return 0, 0.0
    return 1, -(judgement.error_m if judgement.error_m is not None else 1.0)


def caption(judgement: Judgement) -> str:
    """What was found, in a few words."""
    error = "" if judgement.error_m is None else f" {1e3 * judgement.error_m:.0f} mm"
    return f"{judgement.found_category or 'refused'}{error} {judgement.confidence:.2f}"


def calibration_error(confidence: Points, right: Points) -> float:
    """Expected calibration error: the mean distance of confidence and share of right answers over ten bins."""
    if not len(right):
        return 0.0
    bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
    gaps = [abs(confidence[bins == b].sum() - right[bins == b].sum()) for b in np.unique(bins)]
    return float(sum(gaps) / len(right))


def as_record(judgement: Judgement) -> dict[str, Any]:
    return {**asdict(judgement), "right": judgement.right}


def largest_error(
    category: str, true: Mapping[str, Points], found: Mapping[str, Points]
) -> tuple[float | None, str | None]:
    """Largest distance [m] of a key point from the true one, and its name. A towel looks the same from all
    sides, so its corners may be named from any of them."""
    if not set(true) <= set(found):
        return None, None
    names = list(true)
    best: tuple[float, str] | None = None
    for shift in range(len(names)) if category == "towel" else (0,):
        renamed = names[shift:] + names[:shift]
        errors = [float(np.linalg.norm(true[a] - found[b])) for a, b in zip(names, renamed, strict=True)]
        if best is None or max(errors) < best[0]:
            best = max(errors), names[int(np.argmax(errors))]
    return best if best is not None else (None, None)
