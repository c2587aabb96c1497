"""What the perception finds in drawn photographs, and whether that is good enough.

The perception is a black box, called as a user calls it who took a picture from above and states nothing but, in
most pictures, the garment. The limits were set before any result was looked at.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import foldcell
from benchmarks.photographs.outline import Points
from benchmarks.photographs.photograph import Photograph
from foldcell.robots.errors import FailureKind

NEAR = 0.02
"""All key points within this share of the garment's diagonal: right."""
FAR = 0.06
"""A key point beyond this: a fold would be spoilt."""
LIMITS: Mapping[str, tuple[str, float]] = {
    "accepted_share": (">=", 0.95),
    "right_share_of_accepted": (">=", 0.95),
    "beyond_6_percent": ("<=", 0),
    "calibration_error": ("<=", 0.05),
    "wrong_categories": ("<=", 0),
    "accepted_though_due_to_be_refused": ("<=", 0),
    "true_reason_share": (">=", 0.85),
}
TRUE_REASONS: Mapping[str, frozenset[FailureKind]] = {
    "cut": frozenset({FailureKind.OUT_OF_VIEW}),
    "folded": frozenset({FailureKind.NOT_FLAT, FailureKind.HALF_FOLDED}),
    "heap": frozenset({FailureKind.NOT_FLAT, FailureKind.HEAPED}),
    "bunched": frozenset({FailureKind.NOT_FLAT}),
    "two": frozenset({FailureKind.NOT_FLAT, FailureKind.VIEW_OBSTRUCTED}),
    "none": frozenset({FailureKind.NO_GARMENT}),
    "body": frozenset({FailureKind.NO_GARMENT, FailureKind.VIEW_OBSTRUCTED}),
    "print": frozenset({FailureKind.NO_GARMENT}),
}
"""The kinds of failure that say what is wrong in a picture that is due to be refused."""
BINS = 10


@dataclass(frozen=True)
class Judgement:
    """What was found in one picture. due: why it has to be refused, or None. error: the largest of the key points'
    errors on the table as a share of the garment's diagonal; None without key points or if none are true."""

    seed: int
    category: str
    due: str | None
    stated: bool
    ground: str
    outline: str
    accepted: bool
    found_category: str | None
    confidence: float
    error: float | None
    worst_keypoint: str | None
    found_px: dict[str, list[float]]
    failure_kind: str | None
    failure: str | None
    seconds: float
    details: dict[str, Any]

    @property
    def right(self) -> bool:
        """A flat garment, found with its kind and its key points."""
        known = self.due is None and self.found_category == self.category
        return known and self.error is not None and self.error <= NEAR

    @property
    def far(self) -> bool:
        return self.accepted and self.error is not None and self.error > FAR

    @property
    def refused_as_due(self) -> bool:
        return self.due is not None and self.failure_kind in TRUE_REASONS[self.due]


def judge(photograph: Photograph) -> Judgement:
    """Show the photograph to the perception and compare what it says with the truth."""
    garment, details = photograph.garment, photograph.details
    begun = time.perf_counter()
    seen = foldcell.perceive(
        photograph.picture, garment=garment.template if photograph.stated else None, unit="px"
    )
    seconds = time.perf_counter() - begun
    found = {name: np.asarray(p, float)[None, :2] for name, p in seen.keypoints.items()}
    on_table = {name: photograph.camera.on_table(p)[0] for name, p in found.items()}
    error, worst = None, None
    if garment.keypoints and seen.category == garment.category:
        error, worst = largest_error(garment.category, garment.keypoints, on_table)
    return Judgement(
        seed=photograph.seed,
        category=garment.category,
        due=details["due"],
        stated=photograph.stated,
        ground=details["ground"],
        outline=details["outline"],
        accepted=seen.failure is None,
        found_category=seen.category,
        confidence=float(seen.confidence),
        error=None if error is None else error / details["diagonal_m"],
        worst_keypoint=worst,
        found_px={name: p[0].tolist() for name, p in found.items()},
        failure_kind=None if seen.failure is None else str(seen.failure.kind),
        failure=None if seen.failure is None else str(seen.failure),
        seconds=seconds,
        details={"garment": garment.template, **details},
    )


def figures(judgements: list[Judgement]) -> dict[str, float]:
    """The figures that `LIMITS` names, and some more. A share of no pictures is nan."""
    flat = [j for j in judgements if j.due is None]
    due = [j for j in judgements if j.due is not None]
    accepted = [j for j in judgements if j.accepted]
    auto = [j for j in flat if not j.stated]
    return {
        "pictures": len(judgements),
        "flat_garments": len(flat),
        "accepted_share": _share(flat, lambda j: j.accepted),
        "right_share_of_accepted": _share([j for j in flat if j.accepted], lambda j: j.right),
        "beyond_6_percent": sum(j.far for j in flat),
        "wrong_categories": sum(j.accepted and j.found_category != j.category for j in flat),
        "auto": len(auto),
        "auto_right_category_share": _share(auto, lambda j: j.found_category == j.category),
        "auto_wrong_category": sum(j.accepted and j.found_category != j.category for j in auto),
        "due_to_be_refused": len(due),
        "accepted_though_due_to_be_refused": sum(j.accepted for j in due),
        "true_reason_share": _share(due, lambda j: j.refused_as_due),
        "calibration_error": calibration_error(
            np.array([j.confidence for j in accepted]), np.array([j.right for j in accepted], float)
        ),
        "seconds_median": float(np.median([j.seconds for j in judgements])),
    }


def report(judgements: list[Judgement]) -> None:
    """The figures beside their limits, and of parts of the pictures."""
    print_figures(figures(judgements))
    flat = [j for j in judgements if j.due is None]
    parts: dict[str, list[Judgement]] = {
        "garment stated": [j for j in flat if j.stated],
        "garment unknown": [j for j in flat if not j.stated],
        **_by(flat, lambda j: j.category),
        **_by(flat, lambda j: f"on {j.ground}"),
        **_by(flat, lambda j: f"as {j.outline}"),
    }
    print(f"\n{'flat garments':28}pictures  accepted  right of these  beyond 6 %  wrong category")
    for name, part in parts.items():
        if not part:
            continue
        f = figures(part)
        print(
            f"{name:28}{len(part):8}{f['accepted_share']:10.2f}{f['right_share_of_accepted']:16.2f}"
            f"{f['beyond_6_percent']:12.0f}{f['wrong_categories']:16.0f}"
        )
    print(f"\n{'due to be refused':28}pictures  refused  with the true reason")
    for name, part in _by([j for j in judgements if j.due is not None], lambda j: str(j.due)).items():
        print(
            f"{name:28}{len(part):8}{sum(not j.accepted for j in part):9}{sum(j.refused_as_due for j in part):22}"
        )


def held(name: str, value: float) -> bool:
    """Whether the limit is kept. A share of no pictures breaks none."""
    relation, limit = LIMITS[name]
    return math.isnan(value) or (value >= limit if relation == ">=" else value <= limit)


def print_figures(measured: Mapping[str, float]) -> None:
    width = max(map(len, measured)) + 2
    for name, value in measured.items():
        asked = ""
        if name in LIMITS:
            relation, bound = LIMITS[name]
            asked = f"  (asked {relation} {bound}: {'held' if held(name, value) else 'MISSED'})"
        print(f"{name:{width}}{value:9.3f}{asked}")


def as_record(judgement: Judgement) -> dict[str, Any]:
    return {**asdict(judgement), "right": judgement.right, "refused_as_due": judgement.refused_as_due}


def badness(judgement: Judgement) -> tuple[int, float]:
    """For sorting: accepted though due to be refused, then the wrong, the refused, and last the right ones."""
    if judgement.accepted and not judgement.right:
        return 0 if judgement.due is not None else 1, -(judgement.error if judgement.error is not None else 1.0)
    if not judgement.accepted and judgement.due is None:
        return 2, 0.0
    return 4 if judgement.right or judgement.refused_as_due else 3, 0.0


def caption(judgement: Judgement) -> str:
    """What was found, in a few words."""
    if not judgement.accepted:
        return f"refused: {judgement.failure_kind}"
    error = "" if judgement.error is None else f" {100 * judgement.error:.1f} %"
    return f"{judgement.found_category}{error} {judgement.confidence:.2f}"


def calibration_error(confidence: Points, right: Points) -> float:
    """Expected calibration error: the mean distance of confidence and share of right answers over ten bins."""
    if not len(right):
        return 0.0
    bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
    gaps = [abs(confidence[bins == b].sum() - right[bins == b].sum()) for b in np.unique(bins)]
    return float(sum(gaps) / len(right))


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


def _share(judgements: list[Judgement], holds: Callable[[Judgement], bool]) -> float:
    return sum(map(holds, judgements)) / len(judgements) if judgements else float("nan")


def _by(judgements: list[Judgement], key: Callable[[Judgement], str]) -> dict[str, list[Judgement]]:
    return {name: [j for j in judgements if key(j) == name] for name in sorted(set(map(key, judgements)))}
