"""One photograph of the real set, drawn from a seed: a flat garment, or something that has to be refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from shapely.geometry import Polygon

from benchmarks.photographs.canvas import Canvas, photographed, seen_from, under
from benchmarks.photographs.cloth import Colour, cloth_colour, lab, pattern, relief, wrinkles
from benchmarks.photographs.clutter import Parts, lay, scatter
from benchmarks.photographs.lens import Camera, expose, random_camera
from benchmarks.photographs.light import ambient, cast_shadow, highlight, random_light
from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points
from benchmarks.photographs.photograph import Garment, Photograph
from benchmarks.photographs.real import spoilt
from benchmarks.photographs.real.dress import dress
from benchmarks.photographs.real.grounds import GROUNDS, desk_edge, sun
from benchmarks.photographs.real.outlines import Flat, bases, flat, warped
from benchmarks.photographs.real.things import surround

SIZES = ((1024, 768), (768, 1024), (1280, 960), (960, 1280), (800, 600), (1280, 720))
MAX_TILT_DEG = 7.0
"""A camera that is held over the garment by hand; nothing is stated of it."""
REFUSED_SHARE = 0.2
CAUSES = ("cut", "folded", "heap", "two", "none", "bunched")
"""Why a picture has to be refused: the garment is cut by the picture's edge, folded in half, a crumpled heap,
under or over another garment, not there, or has a sleeve that is folded over or pushed together."""
CATEGORIES = {
    "t_shirt": 0.30, "long_sleeve_shirt": 0.22, "pants": 0.14, "shorts": 0.10, "vest": 0.10, "skirt": 0.05,
    "towel": 0.09,
}  # fmt: skip
TRACED_SHARE = 0.5
"""Of the garments of a category that has outlines of real garments."""
STATED_SHARE = 0.7
LEAST_OVERLAP = 0.05
"""Of the first garment, this share or more lies under or over the second."""
TEMPLATES = {
    "pants": ("pants", "jeans"),
    "long_sleeve_shirt": ("long_sleeve_shirt_small", "long_sleeve_shirt_large"),
    "towel": ("small_towel", "medium_towel", "large_towel"),
}


@dataclass(frozen=True, eq=False)
class Layer:
    """A piece of cloth that lies on what is below. height [m]: of its border, for its shadow."""

    outline: Points
    cloth: Field
    height: float


def draw(seed: int, canvas_pixels: int = 1300) -> Photograph:
    """The photograph of that seed. `details["due"]` is None for a flat garment, else one of `CAUSES`."""
    rng = np.random.default_rng([seed, 54])
    due = str(rng.choice(CAUSES)) if rng.random() < REFUSED_SHARE else None
    ground_kind = str(rng.choice(list(GROUNDS)))
    turn = float(np.radians(rng.normal(0, 5)) + (rng.integers(1, 4) * np.pi / 2 if rng.random() < 0.2 else 0.0))
    lying = place(_garment(rng, due), turn, np.array([0.6, 0.0]))
    shapes = stack(rng, due, lying)
    other = other_garment(rng, lying) if due == "two" else None
    extent = np.vstack([*shapes, *([] if other is None else [other.outline])]) if due != "none" else lying.outline
    camera = _camera(rng, extent, ground_kind == "busy")
    if due == "cut":
        camera = moved_aside(rng, camera, extent)
    canvas = under(camera, canvas_pixels)
    light = random_light(rng)
    ground = GROUNDS[ground_kind](rng, canvas)
    if ground_kind == "desk_edge":
        ground = desk_edge(rng, canvas, extent)
    mask = np.max([canvas.mask(s) for s in shapes], axis=0)
    near = ground[mask > 0.5] if (mask > 0.5).any() else ground.reshape(-1, 3)
    main = white_cloth(rng, near.mean(axis=0)) if ground_kind == "white" else cloth_colour(rng, near.mean(axis=0))
    words, cloth = dress(rng, canvas, lying, mask, main, turn, light)
    layers = [Layer(shapes[0], cloth, rng.uniform(0.003, 0.008))]
    for shape in shapes[1:]:
        part = _other_part(
            rng, canvas, main, light, creased=due in ("heap", "bunched"), patterned=words[0] != "plain"
        )
        layers.append(Layer(shape, part, rng.uniform(0.004, 0.012)))
    if other is not None:
        second = cloth_colour(rng, near.mean(axis=0))
        _, second_cloth = dress(rng, canvas, other, canvas.mask(other.outline), second, turn, light)
        layers.insert(int(rng.integers(2)), Layer(other.outline, second_cloth, 0.005))
    if due == "none":
        layers, mask = [], np.zeros_like(mask)
    covered = np.max([mask, *(canvas.mask(layer.outline) for layer in layers)], axis=0)
    things = _things(rng, canvas, camera, covered, ground_kind)
    for thing in things:
        ground = lay(ground, thing, canvas, light)
    depth = rng.uniform(0.3, 0.6)
    for layer in layers:
        cover = canvas.mask(layer.outline)
        ground = ground * cast_shadow(cover, canvas, light, layer.height, depth)[..., None]
        ground = ground + cover[..., None] * (layer.cloth - ground)
    lamp = ambient(rng, canvas, light)
    if ground_kind == "sun" or rng.random() < 0.1:
        lamp = lamp * sun(rng, canvas)
    shine = highlight(rng, canvas) if ground_kind in ("sun", "wood", "boards", "tiles", "desk_edge") else 0.0
    seen = ground * lamp + (shine * (1 - 0.8 * covered))[..., None] if np.ndim(shine) else ground * lamp
    picture = expose(rng, developed(rng, photographed(seen, seen_from(canvas, camera))))[..., ::-1].copy()
    details = {
        "due": due,
        "outline": lying.base,
        "ground": ground_kind,
        "cloth": words,
        "turn_deg": float(np.degrees(turn)),
        "things": len(things),
        "diagonal_m": lying.diagonal_m,
    }
    stated = bool(rng.random() < STATED_SHARE)
    garment = Garment(
        template=str(rng.choice(TEMPLATES.get(lying.category, (lying.category,)))),
        category=lying.category,
        outline=lying.outline,
        keypoints=lying.keypoints if due is None else {},
    )
    return Photograph(seed, picture, garment, camera, stated, details, canvas, covered)


def place(whole: Flat, turn: float, at: Points) -> Flat:
    """The garment on the table: turned, with the middle of its extent at `at` [m]."""
    c, s = np.cos(turn), np.sin(turn)
    turned = whole.outline @ np.array([[c, s], [-s, c]])
    middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
    return replace(whole, outline=turned - middle + at)


def white_cloth(rng: np.random.Generator, ground: Colour) -> Colour:
    """White on white: so near the ground's colour that its shadow and its seams show it, or somewhat darker."""
    while True:
        shift = rng.uniform(-0.12, 0.08) + rng.normal(0, 0.012, 3)
        colour = np.clip(ground + shift, 0.5, 0.97).astype(np.float32)
        if 3.0 <= np.linalg.norm(lab(colour) - lab(ground)) <= 12.0:
            return np.asarray(colour)


def developed(rng: np.random.Generator, light: Field) -> Field:
    """What a telephone makes of the light: exposure by the picture's mean, white balance, a tone curve."""
    gain = np.clip(rng.uniform(0.3, 0.6) / max(float(light.mean()), 1e-3), 0.6, 1.8)
    balance = np.float32([1 + rng.normal(0, 0.05), 1.0, 1 + rng.normal(0, 0.05)])
    exposed = np.clip(light * np.float32(gain) * balance, 0, 1.2)
    return np.asarray(exposed ** np.float32(rng.uniform(0.85, 1.15)), np.float32)


def _garment(rng: np.random.Generator, due: str | None) -> Flat:
    """A garment of which the picture can be what it is due to be."""
    shares = {
        category: share
        for category, share in CATEGORIES.items()
        if (due != "folded" or category in spoilt.FOLDABLE)
        and (due != "bunched" or category in ("t_shirt", "long_sleeve_shirt"))
    }
    total = sum(shares.values())
    category = str(rng.choice(list(shares), p=[share / total for share in shares.values()]))
    own = [base for base in bases().values() if base.category == category]
    traced = any(base.traced for base in own) and bool(rng.random() < TRACED_SHARE)
    chosen = [base for base in own if base.traced == traced]
    return warped(rng, flat(chosen[rng.integers(len(chosen))], rng.uniform(0.002, 0.006)))


def stack(rng: np.random.Generator, due: str | None, lying: Flat) -> list[Points]:
    if due == "folded":
        return spoilt.folded_in_half(rng, lying)
    if due == "heap":
        return spoilt.heap(rng, lying)
    if due == "bunched":
        return spoilt.bunched_sleeve(rng, lying)
    return [lying.outline]


def other_garment(rng: np.random.Generator, lying: Flat) -> Flat:
    """Another garment that lies partly under or over this one."""
    own = Polygon(lying.outline)
    while True:
        whole = _garment(rng, None)
        reach = np.ptp(lying.outline, axis=0) * rng.uniform(0.3, 0.5, 2) * rng.choice([-1, 1], 2)
        other = place(whole, rng.uniform(0, 2 * np.pi), np.array([0.6, 0.0]) + reach)
        if own.intersection(Polygon(other.outline)).area > LEAST_OVERLAP * own.area:
            return other


def _camera(rng: np.random.Generator, extent: Points, wide: bool) -> Camera:
    middle = (extent.min(axis=0) + extent.max(axis=0)) / 2
    spread = middle + (extent - middle) * (rng.uniform(1.1, 1.45) if wide else rng.uniform(0.95, 1.1))
    size = SIZES[rng.integers(len(SIZES))]
    return random_camera(rng, spread, abs(rng.normal(0, MAX_TILT_DEG / 2.5)), size)


def moved_aside(rng: np.random.Generator, camera: Camera, outline: Points) -> Camera:
    """The camera moved until the picture's edge cuts off a part of the garment."""
    angle = rng.integers(4) * np.pi / 2 + rng.normal(0, 0.2)
    share = rng.uniform(0.05, 0.25)
    for step in np.arange(0.0, 2.0, 0.01):
        by = step * np.array([np.cos(angle), np.sin(angle), 0.0])
        moved = replace(
            camera,
            position=tuple(map(float, camera.position + by)),
            target=tuple(map(float, camera.target + by)),
        )
        at = moved.pixels(outline)
        if np.mean(np.any((at < 0) | (at > [camera.width - 1, camera.height - 1]), axis=1)) > share:
            return moved
    raise ValueError("the garment is nowhere cut off")


def _things(
    rng: np.random.Generator, canvas: Canvas, camera: Camera, covered: Field, ground_kind: str
) -> list[Parts]:
    if ground_kind == "busy":
        return surround(rng, canvas, covered)
    if ground_kind == "desk_edge" or rng.random() < 0.6:
        return []
    return scatter(rng, canvas, camera, covered)


def _other_part(
    rng: np.random.Generator, canvas: Canvas, main: Colour, light: Points, *, creased: bool, patterned: bool
) -> Field:
    """Another part or side of the garment's cloth, with its own wrinkles."""
    colours = main * rng.uniform(0.8, 1.1) * np.ones((*canvas.shape, 1), np.float32)
    if patterned:
        _, colours = pattern(rng, canvas, main * rng.uniform(0.8, 1.1), np.array([9.0, 9.0]), rng.uniform(0, 6))
    depth = rng.uniform(0.1, 0.25) if creased else rng.uniform(0.03, 0.09)
    shade = depth * relief(wrinkles(rng, canvas), canvas, light)
    return np.asarray(colours * (1 + np.clip(shade, -0.45, 0.35))[..., None] + 0.01, np.float32)
