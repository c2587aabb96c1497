"""Measures perception on labelled scenes and compares it with the paper's method: `foldcell bench perception`.

The scenes show all shipped garments in turn. Seeds from 0 were used to develop the skill; seeds from `HELD_OUT`
were not. No ground truth reaches the skill: it gets the pictures, the calibration and all garments, but not the
name of the garment in the picture. Times are CPU times of one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from benchmarks.perception.fabrics import LEAST_DIFFERENCE
from benchmarks.perception.folded import measure_inspection
from benchmarks.perception.paper_method import paper_keypoints
from benchmarks.perception.scenes import TABLE, LabelledScene, draw_scene
from benchmarks.perception.strangers import measure_strangers
from benchmarks.shipped_settings import PERCEPTION
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.robots.ports import Array
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.perceive import perceive
from foldcell.skills.vocabulary import Outcome

SCENES, QUICK_SCENES = 400, 33
FOLDS, QUICK_FOLDS = 60, 4
HELD_OUT = 500_000
NEAR, FAR = 0.010, 0.030  # [m]


@dataclass(frozen=True)
class Judged:
    """Result of one scene. accepted: whether a state was returned. named, category: whether garment and category
    are right. error, typical: maximum and median key point error [m]. paper_error: maximum key point error with
    the paper's method [m]. camera_error: error of the camera alone [m]. reason: kind of the failure, '' if
    accepted."""

    garment: str
    accepted: bool
    named: bool
    category: bool
    error: float
    typical: float
    confidence: float
    paper_error: float
    camera_error: float
    time_s: float
    reason: str


def measure(tell: Callable[[str], None], *, peers: bool = False, quick: bool = False) -> Mapping[str, Any]:
    """Measure everything. Return figures with units in their names. A figure can be a list with one mapping per
    garment, range of confidence, or severity of a defect."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        count = QUICK_SCENES if quick else SCENES
        judged = _scenes(tell, 0, count)
        held_out = _scenes(tell, HELD_OUT, count // 3)
        garments = [load_garment(name) for name in list_garments()]
        unknown = measure_strangers(tell, garments, quick)
        folds = QUICK_FOLDS if quick else FOLDS
        inspection = measure_inspection(tell, 0, folds)
        folds_held_out = measure_inspection(tell, HELD_OUT, max(folds // 3, 1))
    finally:
        cv2.setNumThreads(threads)
    return {
        **_figures(judged), **_held_out(_figures(held_out)), **unknown, **inspection, **_held_out(folds_held_out),
    }  # fmt: skip


def _held_out(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of the held-out scenes under names that begin with `held_out_`. Texts are left out,
    because they are the same for all scenes."""
    return {f"held_out_{key}": value for key, value in figures.items() if not isinstance(value, str)}


def _scenes(tell: Callable[[str], None], first: int, count: int) -> list[Judged]:
    garments = [load_garment(name) for name in list_garments()]
    warm = draw_scene(garments[0].name, 2**20)
    perceive(warm.frame, warm.calibration, TABLE, warm.reference, garments, settings=PERCEPTION)
    judged = []
    for seed in range(first, first + count):
        judged.append(_judge(draw_scene(garments[seed % len(garments)].name, seed), garments))
        if len(judged) % 20 == 0:
            near = np.mean([j.error <= NEAR for j in judged if j.accepted])
            tell(f"{len(judged)}/{count} scenes, {near:.1%} of the accepted within {NEAR * 1e3:.0f} mm")
    return judged


def _judge(scene: LabelledScene, garments: Sequence[Garment]) -> Judged:
    start = time.thread_time()
    seen = perceive(scene.frame, scene.calibration, TABLE, scene.reference, garments, settings=PERCEPTION)
    spent = time.thread_time() - start
    garment = next(g for g in garments if g.name == scene.garment)
    errors = _errors(seen.value.state.keypoints if seen.value else {}, scene)
    paper = _errors(paper_keypoints(scene, garment), scene)
    return Judged(
        garment=scene.garment,
        accepted=seen.ok,
        named=seen.ok and seen.unwrap().garment == scene.garment,
        category=_category(seen) == scene.category,
        error=float(errors.max()),
        typical=float(np.median(errors)),
        confidence=seen.unwrap().state.confidence if seen.ok else 0.0,
        paper_error=float(paper.max()),
        camera_error=scene.camera_error,
        time_s=spent,
        reason=str(seen.failure.kind) if seen.failure else "",
    )


def _category(seen: Outcome) -> str:
    return seen.value.state.category if seen.value else ""


def _errors(found: Mapping[str, Array], scene: LabelledScene) -> Array:
    """Compute the errors [m] of all key points, infinite for those that were not found."""
    return np.array(
        [np.linalg.norm(found[n] - p) if n in found else np.inf for n, p in scene.keypoints.items()], dtype=float
    )


def _figures(judged: Sequence[Judged]) -> dict[str, Any]:
    accepted = [j for j in judged if j.accepted]
    times = 1e3 * np.array([j.time_s for j in judged])
    return {
        "scenes": len(judged),
        "least_colour_difference_delta_e": LEAST_DIFFERENCE,
        "accepted_rate": _rate(j.accepted for j in judged),
        "keypoints_within_10mm_rate": _rate(j.error <= NEAR for j in accepted),
        "accepted_beyond_30mm": sum(j.error > FAR for j in accepted),
        "category_rate": _rate(j.category for j in judged),
        "named_rate": _rate(j.named for j in judged),
        "keypoint_error_mm_median": _median(j.typical for j in accepted),
        "camera_error_mm_median": _median(j.camera_error for j in judged),
        "time_ms_median": float(np.median(times)),
        "time_ms_p99": float(np.quantile(times, 0.99)),
        "paper_time_ms": "3000-5000 (Li et al. 2015, segmentation and key points)",
        "paper_method_within_10mm_rate": _rate(j.paper_error <= NEAR for j in judged),
        "paper_method_within_30mm_rate": _rate(j.paper_error <= FAR for j in judged),
        "garments": [_of_garment(name, judged) for name in sorted({j.garment for j in judged})],
        "reliability": _reliability(judged),
        "refusals": {r: sum(j.reason == r for j in judged) for r in sorted({j.reason for j in judged} - {""})},
    }


def _of_garment(name: str, judged: Sequence[Judged]) -> dict[str, Any]:
    ours = [j for j in judged if j.garment == name]
    accepted = [j for j in ours if j.accepted]
    worst = 1e3 * np.array([j.error for j in accepted])
    return {
        "garment": name,
        "scenes": len(ours),
        "accepted_rate": _rate(j.accepted for j in ours),
        "keypoints_within_10mm_rate": _rate(j.error <= NEAR for j in accepted),
        "accepted_beyond_30mm": sum(j.error > FAR for j in accepted),
        "category_rate": _rate(j.category for j in ours),
        "worst_keypoint_mm_median": float(np.median(worst)) if accepted else None,
        "worst_keypoint_mm_p95": float(np.quantile(worst, 0.95)) if accepted else None,
        "time_ms_median": _median(j.time_s for j in ours),
        "paper_method_within_10mm_rate": _rate(j.paper_error <= NEAR for j in ours),
    }


def _reliability(judged: Sequence[Judged]) -> list[dict[str, float]]:
    """Compute the share of accepted scenes with all key points within 10 mm, by ranges of the stated
    confidence."""
    edges = (0.0, 0.6, 0.7, 0.8, 0.9, 0.95, 1.001)
    out = []
    for low, high in pairwise(edges):
        some = [j for j in judged if j.accepted and low <= j.confidence < high]
        if some:
            out.append(
                {
                    "confidence_from": low,
                    "scenes": len(some),
                    "mean_confidence": float(np.mean([j.confidence for j in some])),
                    "within_10mm_rate": _rate(j.error <= NEAR for j in some),
                }
            )
    return out


def _rate(values: Any) -> float:
    values = list(values)
    return float(np.mean(values)) if values else 0.0


def _median(values: Any) -> float:
    """Return the median of lengths [m] or times [s] in mm or ms."""
    values = list(values)
    return 1e3 * float(np.median(values)) if values else 0.0
