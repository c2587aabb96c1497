"""Measures how often objects that are not a shipped garment are accepted as one, seen through the same camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.perception.pieces import Laying, dense, wrinkles
from benchmarks.perception.scenes import TABLE, open_studio
from benchmarks.shipped_settings import PERCEPTION
from foldcell.cell.hardware.camera import nominal_calibration
from foldcell.cell.simulation.garment.fabric import garment_uv
from foldcell.robots.baxter.robot import MOUNT
from foldcell.robots.ports import Array, CameraFrame
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.garments.garment import Garment
from foldcell.skills.perception.perceive import perceive
from foldcell.skills.perception.rectification.camera_refinement import refine_calibration
from foldcell.skills.vocabulary import CameraCalibration


def _plate(rng: np.random.Generator) -> Array:
    a = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return float(rng.uniform(0.12, 0.20)) * np.stack([np.cos(a), np.sin(a)], axis=1)


def _crossing_towels(rng: np.random.Generator) -> Array:
    """Draw the outline of two towels that are laid across each other, a plus."""
    a, b = rng.uniform(0.07, 0.11, 2)
    x, y = rng.uniform(0.18, 0.28, 2)
    return np.array(
        [
            (x, -a),
            (x, a),
            (b, a),
            (b, y),
            (-b, y),
            (-b, a),
            (-x, a),
            (-x, -a),
            (-b, -a),
            (-b, -y),
            (b, -y),
            (b, -a),
        ]
    )


def _bag(rng: np.random.Generator) -> Array:
    """Draw the outline of a bag whose body narrows downwards, with one broad handle."""
    w, h, g = rng.uniform(0.14, 0.18), rng.uniform(0.16, 0.20), rng.uniform(0.04, 0.06)
    half = [(h, g), (0.5 * h, g), (0.5 * h, w), (-h, 0.7 * w)]
    return np.array([*half, *[(x, -y) for x, y in reversed(half)]])


def _blob(rng: np.random.Generator) -> Array:
    """Draw an outline like that of a shirt that was thrown down: three or more lobes, no straight edge."""
    a = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    r = 0.20 * (1 + sum(rng.uniform(0.08, 0.16) * np.cos(k * a + rng.uniform(0, 6)) for k in (2, 3, 5)))
    return r[:, None] * np.stack([np.cos(a), np.sin(a)], axis=1)


def _scarf(rng: np.random.Generator) -> Array:
    w, h = rng.uniform(0.05, 0.07), rng.uniform(0.34, 0.42)
    return np.array([(w, h), (-w, h), (-w, -h), (w, -h)])


def _apron(rng: np.random.Generator) -> Array:
    """Draw the outline of an apron, a kind of garment that is not shipped: a bib on a wide skirt, with ties at its
    sides."""
    w, h, b = rng.uniform(0.20, 0.24), rng.uniform(0.28, 0.32), rng.uniform(0.09, 0.11)
    tie = rng.uniform(0.12, 0.16)
    half = [(-h, w), (0.1 * h, w), (0.1 * h, w + tie), (0.2 * h, w + tie), (0.2 * h, w), (0.45 * h, b), (h, b)]
    return np.array([*half, *[(x, -y) for x, y in reversed(half)]])


def _sock(rng: np.random.Generator) -> Array:
    a, b = rng.uniform(0.05, 0.06), rng.uniform(0.20, 0.26)
    return np.array([(-0.22, -a), (0.24, -a), (0.24, a), (-0.10, a), (-0.10, b), (-0.22, b)])


STRANGERS: Mapping[str, Callable[[np.random.Generator], Array]] = {
    "plate": _plate,
    "crossing_towels": _crossing_towels,
    "bag": _bag,
    "blob": _blob,
    "scarf": _scarf,
    "apron": _apron,
    "sock": _sock,
}
SEEN_OF_EACH, QUICK_SEEN_OF_EACH = 10, 1


def draw_stranger(name: str, seed: int) -> tuple[CameraFrame, CameraFrame, CameraCalibration]:
    """Draw an object. Return its picture, the picture of the empty table, and the executive's calibration."""
    rng = np.random.default_rng([seed, 17])
    outline = STRANGERS[name](rng)
    turn = 0.3 if name == "scarf" else np.pi  # a scarf fits into the view only if it lies across the table
    angle = rng.uniform(-turn, turn)
    c, s = np.cos(angle), np.sin(angle)
    contour = outline @ np.array([[c, s], [-s, c]]) + (rng.uniform(0.57, 0.63), rng.uniform(-0.05, 0.05))
    area = contour[:, 0] @ np.roll(contour[:, 1], -1) - contour[:, 1] @ np.roll(contour[:, 0], -1)
    mesh = mesh_from_contour(dense(contour if area > 0 else contour[::-1], 0.01), 0.02, 1, 0.4)
    with open_studio(garment_uv(mesh.rest, mesh.layer), mesh.triangles, seed) as studio:
        reference = studio.shoot(None)
        frame = studio.shoot(np.column_stack((mesh.rest, 0.002 + wrinkles(rng, Laying())(mesh.rest))))
        drawn = nominal_calibration(MOUNT, TABLE)
        return frame, reference, refine_calibration(reference, drawn, TABLE).value or drawn


def measure_strangers(tell: Callable[[str], None], garments: Sequence[Garment], quick: bool) -> Mapping[str, Any]:
    """Measure the rate of objects that are accepted as a garment, and count the failures reported for the
    others."""
    said: dict[str, list[str]] = {}
    for k, name in enumerate(STRANGERS):
        for i in range(QUICK_SEEN_OF_EACH if quick else SEEN_OF_EACH):
            frame, reference, calibration = draw_stranger(name, 100 * k + i)
            seen = perceive(frame, calibration, TABLE, reference, garments, settings=PERCEPTION)
            what = str(seen.failure.kind) if seen.failure else f"taken for {seen.unwrap().garment}"
            said.setdefault(name, []).append(what)
        tell(f"{name}: {', '.join(sorted(set(said[name])))}")
    return {
        "unknown_scenes": sum(len(v) for v in said.values()),
        "unknown_accepted_rate": float(np.mean([s.startswith("taken") for v in said.values() for s in v])),
        "unknown_things": [
            {"thing": name, "scenes": len(v), "accepted_rate": float(np.mean([s.startswith("taken") for s in v])),
             "said": {s: v.count(s) for s in sorted(set(v))}}
            for name, v in said.items()
        ],
    }  # fmt: skip
