"""One photograph of the phone set, drawn from a seed: a flat garment, or something that has to be refused."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas, under
from benchmarks.photographs.clutter import scatter
from benchmarks.photographs.lens import Camera
from benchmarks.photographs.light import ambient, highlight
from benchmarks.photographs.noise import Field, smooth
from benchmarks.photographs.outline import Points
from benchmarks.photographs.phone.dress import dressed, dye
from benchmarks.photographs.phone.garments import CATEGORIES, garment
from benchmarks.photographs.phone.grounds import GROUNDS, linear
from benchmarks.photographs.phone.relief import light, lit, profile, wrinkles
from benchmarks.photographs.photograph import Garment, Photograph
from benchmarks.photographs.real import spoilt
from benchmarks.photographs.real.outlines import Flat
from benchmarks.photographs.real.photograph import TEMPLATES, moved_aside, other_garment, place, stack
from benchmarks.photographs.real.things import NEARBY

SIZES = ((1280, 960), (1600, 1200), (1920, 1080), (2048, 1536), (3264, 2448), (4000, 3000))
CAUSES = ("cut", "folded", "heap", "two", "none", "bunched", "body", "print")
"""Why every fourth picture has to be refused: the garment is cut by the picture's edge, folded in half, a heap, on
another garment, not there, or has a sleeve that is folded over or pushed together; there is only a hand, or only a
motif that is printed on the ground."""
EMPTY = ("none", "body", "print")
SUITED = {"folded": spoilt.FOLDABLE, "bunched": ("t_shirt", "long_sleeve_shirt")}


def draw(seed: int, canvas_pixels: int = 1800) -> Photograph:
    """The photograph of that seed. `details["due"]` is None for a flat garment, else one of `CAUSES`."""
    rng = np.random.default_rng([seed, 77])
    due = CAUSES[seed // 4 % len(CAUSES)] if seed % 4 == 0 else None
    turn = float(np.radians(rng.normal(0, 6)))
    lying = place(garment(rng, SUITED.get(str(due), tuple(CATEGORIES))), turn, np.array([0.6, 0.0]))
    shapes = layers(rng, due, lying)
    near_hand = 0.5 * (lying.outline - lying.outline.mean(axis=0)) + [0.62, 0.0]
    camera = phone(rng, near_hand if due == "body" else np.vstack(shapes or [lying.outline]))
    if due == "cut":
        camera = moved_aside(rng, camera, lying.outline)
    canvas, lamp = under(camera, canvas_pixels, 0.0004), light(rng)
    kind = str(rng.choice(list(GROUNDS)))
    colours, height = GROUNDS[kind](rng, canvas)
    covers = [canvas.mask(shape) for shape in shapes]
    covered = np.max([np.zeros(canvas.shape, np.float32), *covers], axis=0)
    near = colours[covered > 0.5] if covered.any() else colours.reshape(-1, 3)
    shown = np.clip(near.mean(axis=0), 0, 1) ** (1 / 2.2)
    words, cloth, sewing = dressed(rng, canvas, lying, covered, shown, turn)
    if due == "print":
        motif = canvas.mask(lying.outline.mean(axis=0) + _motif(rng))
        colours = colours + 0.85 * motif[..., None] * (linear(dye(rng)) - colours)
    things = [] if due is None and rng.random() < 0.3 else scatter(rng, canvas, camera, covered, NEARBY)
    for cover, colour, rise in (part for thing in things for part in thing):
        soft = cv2.GaussianBlur(cover, (0, 0), 1.2)
        height, colours = height + rise * soft, colours + cover[..., None] * (linear(colour) - colours)
    thickness = rng.uniform(0.002, 0.005) if lying.category == "towel" else rng.uniform(0.0008, 0.0022)
    strength = rng.uniform(0.35, 1.4) if due != "heap" else rng.uniform(4, 6)
    for i, cover in enumerate(covers):
        top = cloth
        if i and due != "heap":  # another garment, or the other side of the cloth
            back = linear(dye(rng, shown)) if due == "two" else cloth.mean(axis=(0, 1)) * rng.uniform(0.8, 1.05)
            top, sewing = back + 0 * cloth, 0 * sewing
        height = draped(rng, canvas, height, cover, thickness, strength, sewing * (due in (None, "cut", "two")))
        colours = colours + cover[..., None] * (top - colours)
    if due == "body":
        colours, height = hand(rng, canvas, colours, height)
    seen = colours * lit(height, canvas, lamp)[..., None] * ambient(rng, canvas, np.array(lamp.lamps[0][:2]))
    if kind not in ("sheet", "carpet", "ironing board"):
        seen = seen + (highlight(rng, canvas) * (1 - covered))[..., None]
    details = {
        "due": due, "outline": lying.base, "ground": kind, "light": lamp.kind, "cloth": words,
        "turn_deg": float(np.degrees(turn)) + camera.roll_deg, "things": len(things),
        "diagonal_m": lying.diagonal_m,
    }  # fmt: skip
    template = str(rng.choice(TEMPLATES.get(lying.category, (lying.category,))))
    known = Garment(template, lying.category, lying.outline, lying.keypoints if due is None else {})
    picture = taken(rng, seen, canvas, camera)
    return Photograph(seed, picture, known, camera, seed % 5 < 3, details, canvas, covered)


def layers(rng: np.random.Generator, due: str | None, lying: Flat) -> list[Points]:
    """Outlines of what lies there, from below upwards."""
    if due in EMPTY:
        return []
    shapes = stack(rng, due, lying)
    return [*shapes, other_garment(rng, lying).outline] if due == "two" else shapes


def draped(
    rng: np.random.Generator, canvas: Canvas, height: Field, cover: Field, thickness: float, strength: float,
    sewing: Field,
) -> Field:  # fmt: skip
    """The height field with one more layer of cloth, which bridges small steps below and wrinkles more inside."""
    away = cv2.distanceTransform((cover > 0.5).astype(np.uint8), cv2.DIST_L2, 5) * canvas.pixel
    waves = wrinkles(rng, canvas, strength)
    waves = np.clip(waves - np.quantile(waves[::4, ::4], 0.15), 0, None) * (1 - 0.75 * np.exp(-away / 0.025))
    below = cv2.GaussianBlur(height, (0, 0), 0.004 / canvas.pixel)
    raised = below + profile(cover, canvas, thickness) + waves + sewing
    return np.asarray(height + cover * (raised - height), np.float32)


def phone(rng: np.random.Generator, extent: Points) -> Camera:
    """A telephone on a tripod or in a hand, tilted to any side, and sometimes turned by a quarter or a half."""
    width, height = SIZES[rng.integers(len(SIZES))][:: rng.choice([-1, 1])]
    view = rng.uniform(45, 70) if width > height else rng.uniform(36, 56)
    tilt = np.radians(rng.uniform(0, 3) if rng.random() < 0.35 else min(abs(rng.normal(0, 7)), 15.0))
    turn = rng.normal(np.pi, 1.2)  # who takes the picture stands at the near side, mostly
    roll = rng.normal(0, 2) + (90.0 * rng.integers(1, 4) if rng.random() < 0.3 else 0.0)
    middle = (extent.min(axis=0) + extent.max(axis=0)) / 2 + rng.normal(0, 0.02, 2)
    margin = rng.uniform(0.015, 0.12)
    for distance in np.arange(0.3, 8.0, 0.01):
        lean = distance * np.sin(tilt) * np.array([np.cos(turn), np.sin(turn)])
        at = (float(middle[0] + lean[0]), float(middle[1] + lean[1]), float(distance * np.cos(tilt)))
        camera = Camera(width, height, view, at, (float(middle[0]), float(middle[1]), 0.0), 0.0, float(roll))
        seen = camera.pixels(extent) / [width, height]
        if seen.min() > margin and seen.max() < 1 - margin:
            return camera
    raise ValueError("no camera sees the whole garment")


def hand(rng: np.random.Generator, canvas: Canvas, colours: Field, height: Field) -> tuple[Field, Field]:
    """A forearm that reaches in from the near side, with an open hand."""
    tones = [[0.62, 0.72, 0.90], [0.42, 0.56, 0.78], [0.25, 0.36, 0.55], [0.14, 0.2, 0.33]]
    skin = linear(np.float32(tones[rng.integers(4)]))
    turn = rng.normal(0, 0.35)
    up, side = (
        np.array([np.cos(turn), np.sin(turn)]),
        np.array([-np.sin(turn), np.cos(turn)]) * rng.choice([-1, 1]),
    )
    wrist = np.array([0.6, 0.0]) + rng.normal(0, 0.06, 2)
    cover = canvas.mask(
        wrist + np.outer([-3, 0, 0.02, 0.02, 0, -3], up) + np.outer([-0.1, -0.03, -0.04, 0.04, 0.03, 0.1], side)
    )
    cover = np.maximum(
        cover, canvas.mask(wrist + np.outer([0, 0.1, 0.1, 0], up) + np.outer([-0.033, -0.043, 0.043, 0.033], side))
    )
    for at, way, length in (
        (-0.034, -0.18, 0.075),
        (-0.012, -0.05, 0.09),
        (0.012, 0.05, 0.085),
        (0.034, 0.17, 0.065),
    ):
        tip = (0.095 + length) * up + (at + way * length) * side
        cover = np.maximum(cover, canvas.line(wrist + np.array([0.09 * up + at * side, tip]), 0.019))
    cover = np.maximum(
        cover, canvas.line(wrist + np.array([0.03 * up - 0.03 * side, 0.085 * up - 0.085 * side]), 0.023)
    )
    away = cv2.distanceTransform((cover > 0.5).astype(np.uint8), cv2.DIST_L2, 5) * canvas.pixel
    mottled = skin * (1 + 0.05 * smooth(rng, canvas.shape, (6, 6)))[..., None]
    rounded = 0.15 * np.sqrt(np.clip(away, 0, 0.03))
    return colours + cover[..., None] * (mottled - colours), height + cv2.GaussianBlur(rounded, (0, 0), 2.0)


def taken(rng: np.random.Generator, seen: Field, canvas: Canvas, camera: Camera) -> np.ndarray:
    """What the telephone makes of the light: lens, exposure, white balance, noise, tones, sharpening, JPEG."""
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    origin, column, row = np.array(canvas.far_left) - corner[:, ::-1] * canvas.pixel
    onto = np.array([[*(column - origin)], [*(row - origin)], [*origin]]).T
    onto = camera.homography @ np.vstack([onto, [0, 0, 1]])
    finer = (
        float(np.ptp(canvas.at(camera.on_table(np.array([[0.0, 0.0], [camera.width, 0.0]]))), axis=0).max())
        / camera.width
    )
    blurred = cv2.GaussianBlur(seen, (0, 0), rng.uniform(0.3, 0.6) * max(1.0, finer))
    shot = cv2.warpPerspective(blurred, onto, (camera.width, camera.height), borderMode=cv2.BORDER_REPLICATE)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    radius = ((u / camera.width - 0.5) ** 2 + (v / camera.height - 0.5) ** 2).astype(np.float32)
    shot *= (1 - rng.uniform(0.1, 0.5) * radius)[..., None]
    gain = np.clip(rng.uniform(0.18, 0.34) / float(shot.mean()), 0.5, 2.2)
    shot *= np.float32(gain * np.array([1 + rng.normal(0, 0.07), 1.0, 1 + rng.normal(0, 0.07)]))
    noise = rng.standard_normal(shot.shape, dtype=np.float32)
    if rng.random() < 0.5:
        noise = 1.6 * cv2.GaussianBlur(noise, (0, 0), 0.8)
    shot += noise * rng.uniform(0.004, 0.02) * np.sqrt(np.clip(shot, 0.01, 1))
    shown = np.clip(shot, 0, 1) ** np.float32(1 / 2.2)
    shown += rng.uniform(0, 0.25) * shown * (1 - shown) * (2 * shown - 1)
    shown += rng.uniform(0.1, 0.7) * (shown - cv2.GaussianBlur(shown, (0, 0), 1.3))
    packed = cv2.imencode(".jpg", np.clip(shown * 255, 0, 255).astype(np.uint8), [1, int(rng.integers(75, 96))])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR)[..., ::-1].copy())


def _motif(rng: np.random.Generator) -> Points:
    """A flower about its middle [m]."""
    turn, petals = np.linspace(0, 2 * np.pi, 200), rng.integers(5, 9)
    reach = rng.uniform(0.08, 0.2) * (1 + rng.uniform(0.25, 0.6) * np.cos(petals * turn))
    return np.asarray(np.column_stack([reach * np.cos(turn), reach * np.sin(turn)]))
