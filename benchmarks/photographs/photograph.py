"""One photograph of a flat garment, drawn from a seed, with what is true in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.photographs.canvas import Canvas, photographed, seen_from, under
from benchmarks.photographs.cloth import cloth_colour, dress
from benchmarks.photographs.clutter import lay, scatter
from benchmarks.photographs.lens import Camera, expose, random_camera
from benchmarks.photographs.light import ambient, cast_shadow, highlight, random_light
from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points
from benchmarks.photographs.shapes import GARMENTS, Garment
from benchmarks.photographs.table import draw_table

SIZES = ((640, 480), (800, 600), (1024, 768), (1280, 960), (1280, 720))
MAX_TILT_DEG = 25.0
"""Of the cell's camera. Its place is stated to the perception."""
MAX_LOOSE_TILT_DEG = 4.0
"""Of a camera of which nothing is stated, held as straight down as a hand can."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """picture: (rows, columns, 3) uint8, red first. reference: the same table without the garment, or None.
    garment: as it lies on the table [m]. mask: the garment on the canvas. known_camera: whether the perception may
    be told the camera. stated: whether it may be told the garment."""

    seed: int
    picture: np.ndarray
    reference: np.ndarray | None
    garment: Garment
    camera: Camera
    known_camera: bool
    stated: bool
    details: dict[str, Any]
    canvas: Canvas
    mask: Field
    clutter: Field

    @property
    def truth(self) -> dict[str, Any]:
        names = list(self.garment.keypoints)
        table = np.array([self.garment.keypoints[name] for name in names]).reshape(-1, 2)
        camera = self.camera
        return {
            "seed": self.seed,
            "category": self.garment.category,
            "garment": self.garment.template,
            "keypoints_m": dict(zip(names, table.tolist(), strict=True)),
            "keypoints_px": dict(zip(names, camera.pixels(table).tolist(), strict=True)),
            "table_to_undistorted_pixels": camera.homography.tolist(),
            "distortion_k1": camera.k1,
            "camera": {
                "position": list(camera.position),
                "target": list(camera.target),
                "width": camera.width,
                "height": camera.height,
                "view_deg": camera.view_deg,
            },
            "known_camera": self.known_camera,
            "stated": self.stated,
            "reference": self.reference is not None,
            **self.details,
        }


def draw(seed: int, canvas_pixels: int = 1300) -> Photograph:
    """The photograph of that seed. canvas_pixels: fineness of what is photographed."""
    rng = np.random.default_rng([seed, 20])
    known_camera = bool(rng.random() < 0.7)
    stated = bool(rng.random() < 0.7)
    with_reference = known_camera and bool(rng.random() < 0.5)
    garment = GARMENTS[rng.integers(len(GARMENTS))](rng)
    turn = _turn(rng, garment, known_camera)
    lying = placed(garment, turn, np.array([0.6, 0.0]) + rng.uniform(-0.04, 0.04, 2))
    tilt = rng.uniform(0, MAX_TILT_DEG) if known_camera else rng.uniform(0, MAX_LOOSE_TILT_DEG)
    camera = random_camera(rng, lying.outline, tilt, SIZES[rng.integers(len(SIZES))])
    canvas = under(camera, canvas_pixels)
    mask = canvas.mask(lying.outline)
    light = random_light(rng)
    table_kind, table = draw_table(rng, canvas)
    main = cloth_colour(rng, table[mask > 0.5].mean(axis=0))
    pattern, cloth = dress(rng, canvas, lying, mask, main, turn, light)
    things = scatter(rng, canvas, camera, mask)
    shine = highlight(rng, canvas) if table_kind != "cloth" else np.zeros(canvas.shape, np.float32)
    lamp = ambient(rng, canvas, light)
    for thing in things:
        table = lay(table, thing, canvas, light)
    shadow = cast_shadow(mask, canvas, light, rng.uniform(0.003, 0.008), rng.uniform(0.2, 0.5))
    ground = (table * shadow[..., None]) * lamp + shine[..., None]
    seen = ground + mask[..., None] * (cloth * lamp - ground)
    sight = seen_from(canvas, camera)
    exposures = int(rng.integers(2**32)), rng.uniform(0.97, 1.03)
    picture = expose(rng, photographed(seen, sight))[..., ::-1].copy()
    reference = None
    if with_reference:
        # The camera adapts to the empty table: another brightness, other noise.
        empty = photographed(table * lamp + shine[..., None], sight) * np.float32(exposures[1])
        reference = expose(np.random.default_rng(exposures[0]), empty)[..., ::-1].copy()
    clutter = np.zeros(canvas.shape, np.float32)
    for thing in things:
        clutter = np.maximum(clutter, np.max([part[0] for part in thing], axis=0))
    details = {
        "table": table_kind,
        "pattern": pattern,
        "tilt_deg": tilt,
        "turn_deg": float(np.degrees(turn)),
        "things": len(things),
    }
    return Photograph(
        seed, picture, reference, lying, camera, known_camera, stated, details, canvas, mask, clutter
    )  # fmt: skip


def _turn(rng: np.random.Generator, garment: Garment, known_camera: bool) -> float:
    """Angle [rad] at which the garment lies. Before the cell's camera it lies as the cell asks for, roughly.
    Others lay it with the collar or the waist up, or to any side."""
    askew = np.radians(rng.uniform(-12, 12))
    if known_camera:
        return float(garment.laid_turn + askew)
    return float((rng.integers(4) * np.pi / 2 if rng.random() < 0.4 else 0.0) + askew)


def placed(garment: Garment, turn: float, at: Points) -> Garment:
    """The garment on the table: turned, with its middle at `at` [m]."""
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, s], [-s, c]])  # for rows
    middle = (garment.outline @ matrix).mean(axis=0)

    def move(points: Points) -> Points:
        return np.asarray(points @ matrix - middle + at)

    return replace(
        garment,
        outline=move(garment.outline),
        keypoints={name: move(p) for name, p in garment.keypoints.items()},
        hems=tuple(map(move, garment.hems)),
        seams=tuple(map(move, garment.seams)),
        inside=None if garment.inside is None else move(garment.inside),
        placket=None if garment.placket is None else move(garment.placket),
    )
