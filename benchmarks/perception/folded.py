"""Tests the inspection's diagnoses on folded garments with a defect of known size, seen through the simulated
camera.

Folds that two arms make: both folds of the towels; trousers with one leg on the other, and folded across; shirts
with the hem folded up over the sleeves. Folds that one arm makes: a sleeve of a shirt onto its body.

A folded garment is computed as the isometry of the flat garment in the plan's lines. A defect is a displacement of
the moved part, or of the whole garment. Its size is a length [m]: the drift of the whole garment, the lag of the
moved edge's middle or of a dropped corner, or the height of a ridge. Every fold, even a good one, has a small
error, a bulging crease and wrinkles. The cell's cloth solver is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.pieces import Laying, dense, wrinkles
from benchmarks.perception.scenes import TABLE, Studio, open_studio
from benchmarks.shipped_settings import INSPECTION, PERCEPTION
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.hardware.camera import nominal_calibration
from foldcell.cell.simulation.garment.fabric import garment_uv
from foldcell.cell.simulation.garment.outline import draw_outline
from foldcell.cell.simulation.noise import load_noise
from foldcell.robots.baxter.robot import MOUNT
from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.fold_plan.folding import fold_xy, target_vertices
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.inspection.inspect import inspect
from foldcell.skills.perception.perceive import perceive
from foldcell.skills.perception.rectification.camera_refinement import refine_calibration
from foldcell.skills.vocabulary import CameraCalibration, FoldStep, GarmentState, PredictedShape, frozen

FOLDS = (
    *((towel, index) for towel in ("small_towel", "medium_towel", "large_towel") for index in (0, 1)),
    ("pants", 0), ("pants", 1), ("jeans", 0), ("jeans", 1),
    ("long_sleeve_shirt_small", 2), ("long_sleeve_shirt_large", 2),
    ("long_sleeve_shirt_small", 0), ("long_sleeve_shirt_large", 1),
)  # fmt: skip
"""Garments, each with the index of the fold after which it is inspected."""
CURVES: Mapping[FailureKind, tuple[float, ...]] = {
    FailureKind.DRIFT: (0.010, 0.020, 0.030, 0.040, 0.060),
    FailureKind.PILING: (0.010, 0.015, 0.020, 0.030, 0.045),
    FailureKind.SAG: (0.010, 0.020, 0.030, 0.040, 0.060),
    FailureKind.DROPPED_CORNER: (0.040, 0.060, 0.080, 0.120),
    FailureKind.MISSED_LAYER: (1.0,),
}
"""Severities of each defect [m]. A missed layer (one of two layers was not moved) has no severity; its 1.0 is a
placeholder."""
JUDGED_AT = {
    FailureKind.DRIFT: 0.040,
    FailureKind.PILING: 0.030,
    FailureKind.SAG: 0.040,
    FailureKind.DROPPED_CORNER: 0.080,
    FailureKind.MISSED_LAYER: 1.0,
}
GOOD_LOOKS = 4
"""Number of pictures of good folds for each folded garment."""


@dataclass(frozen=True, eq=False)
class Folded:
    """One garment in front of the camera. `look` takes a picture of it after the fold `step`, with a given defect.
    lower: function that returns the height of the wrinkles of the flat garment at (n, 2) [m]."""

    garment: Garment
    step: FoldStep
    predicted: PredictedShape
    calibration: CameraCalibration
    reference: CameraFrame
    flat_top: float | None
    mesh: ClothMesh
    studio: Studio
    rng: np.random.Generator

    lower: Callable[[Array], Array]

    def before(self) -> CameraFrame:
        """Take a picture of the garment before this fold."""
        x = target_vertices(self.mesh, self.step.earlier, self.garment.material)
        x[:, 2] += self.lower(x[:, :2])
        return self.studio.shoot(x)

    def look(self, defect: FailureKind | None = None, severity: float = 0.0) -> CameraFrame:
        return self.studio.shoot(_folded(self, defect, severity))


def defects(folded: Folded) -> Iterator[tuple[FailureKind, float]]:
    """Yield the defects that this fold can have: kinds and severities [m]."""
    for kind, sizes in CURVES.items():
        if kind is FailureKind.MISSED_LAYER and not _can_miss_a_layer(folded):
            continue
        if kind in (FailureKind.SAG, FailureKind.DROPPED_CORNER) and len(folded.step.grasps) < 2:
            continue  # with one hand, cloth cannot sag between hands, and no hand can lag behind the other
        yield from ((kind, size) for size in sizes)


def measure_inspection(tell: Callable[[str], None], first_seed: int, count: int) -> dict[str, Any]:
    """Measure the rates of correct diagnoses over severity, and of false alarms on good folds."""
    said: dict[tuple[FailureKind | None, float], list[FailureKind | str | None]] = {}
    of_fold: dict[tuple[str, str], list[bool]] = {}
    for seed in range(first_seed, first_seed + count):
        name, index = FOLDS[seed % len(FOLDS)]
        for folded in open_folded(name, seed, index):
            cases: list[tuple[FailureKind | None, float]] = [(None, 0.0)] * GOOD_LOOKS
            before = folded.before()
            for kind, size in [*cases, *defects(folded)]:
                answer = judge(folded, folded.look(kind, size), before)
                said.setdefault((kind, size), []).append(answer)
                if kind is None or JUDGED_AT[kind] == size:
                    of_fold.setdefault((name, folded.step.name), []).append(answer is kind)
        if (seed + 1 - first_seed) % 10 == 0:
            tell(f"{seed + 1 - first_seed}/{count} folds inspected")
    rates = {key: float(np.mean([k is key[0] for k in kinds])) for key, kinds in said.items()}
    at = {kind: rates[kind, size] for kind, size in JUDGED_AT.items() if (kind, size) in rates}
    return {
        "inspection_folds_seen": count,
        "inspection_pictures": sum(len(v) for v in said.values()),
        "inspection_detection_rate": float(np.mean(list(at.values()))),
        "inspection_false_alarm_rate": 1.0 - rates[None, 0.0],
        **{f"inspection_{kind.value}_rate": rate for kind, rate in at.items()},
        "inspection_curves": [
            {
                "defect": kind.value, "severity_mm": 1e3 * size if kind is not FailureKind.MISSED_LAYER else None,
                "pictures": len(said[kind, size]), "diagnosed_rightly_rate": rates[kind, size],
                "noticed_rate": float(np.mean([k is not None for k in said[kind, size]])),
                "said": _counts(said[kind, size]),
            }
            for kind, sizes in CURVES.items() for size in sizes if (kind, size) in said
        ],
        "inspection_good_folds_said": _counts(said[None, 0.0]),
        "inspection_folds": [
            {"garment": name, "fold": fold, "judged": len(right), "judged_rightly_rate": float(np.mean(right))}
            for (name, fold), right in sorted(of_fold.items())
        ],
    }  # fmt: skip


def judge(folded: Folded, frame: CameraFrame, before: CameraFrame | None = None) -> FailureKind | str | None:
    """Inspect a picture. Return the kind of a failed fold, None for a good fold, or, as text, the reason why the
    fold cannot be judged.

    before: the picture before the fold.
    """
    seen = inspect(
        frame, folded.calibration, TABLE, folded.reference, folded.predicted, folded.step,
        settings=INSPECTION, previous=before, flat_top=folded.flat_top,
    )  # fmt: skip
    return str(seen.failure.kind) if seen.failure else seen.unwrap().diagnosis


def _counts(kinds: list[FailureKind | str | None]) -> dict[str, int]:
    named = ["good" if k is None else str(k) for k in kinds]
    return {name: named.count(name) for name in sorted(set(named))}


def open_folded(name: str, seed: int, index: int) -> Iterator[Folded]:
    """Yield the one garment of a seed, to be inspected after fold `index`. The renderer is closed when the
    iteration ends."""
    rng = np.random.default_rng([seed, 11])
    garment = load_garment(name)
    pose = garment.poses.sample(rng)
    outline = draw_outline(garment, load_noise().garment, rng)
    mesh = mesh_from_contour(_placed(dense(outline.contour, 0.006), pose), 0.018, garment.layers, 0.4)
    lying = {name: _placed(p[None], pose)[0] for name, p in outline.keypoints.items()}
    known = {name: frozen(p + rng.normal(0.0, 0.0015, 2)) for name, p in lying.items()}
    contour = np.array([known[n] for n in garment.keypoints])
    state = GarmentState(garment.category, contour, known, 1.0)
    step = plan_folds(state, garment).unwrap()[index]
    believed = mesh_from_contour(contour, garment.mesh_edge_m, garment.layers, 0.1)
    predicted = PredictedShape(
        target_vertices(believed, step.lines, garment.material), believed.triangles, believed.rest
    )
    with open_studio(garment_uv(mesh.rest, mesh.layer), mesh.triangles, seed) as studio:
        reference = studio.shoot(None)
        drawn = nominal_calibration(MOUNT, TABLE)
        held = refine_calibration(reference, drawn, TABLE).value or drawn
        lower = wrinkles(np.random.default_rng([seed, 12]), WRINKLED)
        flat = target_vertices(mesh, (), garment.material)
        flat[:, 2] += lower(mesh.rest)
        seen = perceive(studio.shoot(flat), held, TABLE, reference, [garment], settings=PERCEPTION)
        top = seen.value.top if seen.value else None
        yield Folded(garment, step, predicted, held, reference, top, mesh, studio, rng, lower)


WRINKLED = Laying(wrinkle=0.0015)
STIRRED = 0.3
"""A fold adds new creases to all cloth. This is the height of the new creases in the cloth that stays,
relative to those in the moved cloth."""


def _placed(points: Array, pose: tuple[float, float, float]) -> Array:
    x, y, angle = pose
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + (x, y))


def _folded(folded: Folded, defect: FailureKind | None, severity: float) -> Array:
    """Compute the vertices (n, 3) of the garment after the fold with a defect, table frame."""
    rng, step, mesh = folded.rng, folded.step, folded.mesh
    thickness = folded.garment.material
    before = fold_xy(step.earlier, mesh.rest)
    stays = np.zeros(len(before), bool)
    if defect is FailureKind.MISSED_LAYER:  # only the upper layer was grasped
        stays = ~_moved(step, mesh.rest)
    x = target_vertices(mesh, step.lines, thickness)
    unfolded = target_vertices(mesh, step.earlier, thickness)
    d = np.maximum(step.line.signed_distance(before), 0.0)
    x[stays] = unfolded[stays]
    d[stays] = 0.0
    x += _bulge(d, x[:, 2])
    x[:, :2] += step.line.normal * (d / d.max() * _behind(folded, before, defect, severity))[:, None]
    if defect is FailureKind.PILING:
        x += _ridge(folded, before, d, severity)
    # The lower cloth keeps its creases and shapes the cloth above it. Both also get new creases.
    own = wrinkles(rng, WRINKLED)(mesh.rest)
    x[:, 2] += folded.lower(x[:, :2]) + np.where(d > 0, own, STIRRED * own)
    return _drifted(x, rng, severity if defect is FailureKind.DRIFT else 0.0)


def _can_miss_a_layer(folded: Folded) -> bool:
    """Whether this fold moves cloth that an earlier fold laid on top, and also the cloth below it."""
    moves = folded.step.line.signed_distance(fold_xy(folded.step.earlier, folded.mesh.rest)) > 0
    turned = _moved(folded.step, folded.mesh.rest)
    return bool(np.count_nonzero(moves & turned) > 0.2 * np.count_nonzero(moves & ~turned) > 0)


def _moved(step: FoldStep, rest: Array) -> NDArray[np.bool_]:
    """Return (n,) whether an earlier fold has moved each point of rest (n, 2), so that it lies on top."""
    turned = np.zeros(len(rest), bool)
    p = np.array(rest)
    for line in step.earlier:
        moving = line.signed_distance(p) > 0
        turned |= moving
        p = np.where(moving[:, None], line.reflect(p), p)
    return turned


def _behind(folded: Folded, before: Array, defect: FailureKind | None, severity: float) -> Array:
    """Compute for each vertex the lag (n,) of the moved part's far edge [m] at the vertex's position along the
    fold line."""
    rng, step = folded.rng, folded.step
    along = (before - step.line.point) @ step.line.direction
    across = step.line.signed_distance(before)
    a, b = _span(step, along[across > 0.6 * across.max()])
    t = np.clip((along - a) / (b - a), 0.0, 1.0)
    own = rng.normal(0.0, 0.002, 3)  # the small error that every fold has
    behind = own[0] * t + own[1] * (1.0 - t) + abs(own[2]) * np.sin(np.pi * t)
    if defect is FailureKind.SAG:
        behind = behind + severity * np.sin(np.pi * t)
    if defect is FailureKind.DROPPED_CORNER:
        lost = t if rng.random() < 0.5 else 1.0 - t
        behind = behind + severity * lost**1.5
    return np.asarray(behind)


def _span(step: FoldStep, far: Array) -> tuple[float, float]:
    """Return the two hands' positions along the fold line [m]; for one hand, the ends of the moved part's far
    edge."""
    at = sorted(float((g.point - step.line.point) @ step.line.direction) for g in step.grasps.values())
    return (at[0], at[1]) if len(at) == 2 else (float(far.min()), float(far.max()))


def _bulge(d: Array, z: Array) -> Array:
    """Compute the displacement (n, 3) of the vertices by an unpressed crease: the moved layers rise near the
    line."""
    rise = 0.006 * np.exp(-((d / 0.015) ** 2)) * (d > 0)
    return np.column_stack([np.zeros((len(z), 2)), rise])


def _ridge(folded: Folded, before: Array, d: Array, height: float) -> Array:
    """Compute the displacement (n, 3) of the vertices by piled cloth: a ridge near the target. The cloth of the
    ridge is missing at the edge, which therefore does not reach as far."""
    step = folded.step
    along = (before - step.line.point) @ step.line.direction
    a, b = _span(step, along[d > 0.6 * d.max()])
    centre, spread = a + folded.rng.uniform(0.25, 0.75) * (b - a), 0.35 * (b - a)
    window = np.exp(-(((along - centre) / spread) ** 4))
    at, half = 0.75 * d.max(), 0.030
    up = height * window * np.exp(-(((d - at) / half) ** 2))
    taken = 1.2 * (height * window) ** 2 / half * (1.0 / (1.0 + np.exp(-(d - at) / (0.4 * half))))
    return np.column_stack([step.line.normal[None] * np.minimum(taken, 0.04)[:, None], up * (d > 0)])


def _drifted(x: Array, rng: np.random.Generator, severity: float) -> Array:
    direction = rng.uniform(0, 2 * np.pi)
    shift = severity * np.array([np.cos(direction), np.sin(direction)]) + rng.normal(0.0, 0.003, 2)
    turn = rng.normal(0.0, 0.008)
    c, s = np.cos(turn), np.sin(turn)
    middle = x[:, :2].mean(axis=0)
    x[:, :2] = (x[:, :2] - middle) @ np.array([[c, s], [-s, c]]) + middle + shift
    return x
