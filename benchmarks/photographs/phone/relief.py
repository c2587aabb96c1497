"""Light on a height field [m] of cloth, ground and things: slopes face it or not, and things throw shadows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.noise import Field, smooth, turned

Direction = tuple[float, float, float]
"""(column, row, up), of unit length: where a light comes from."""
FARTHEST = 0.14
"""[m] A shadow that reaches farther is cut off."""


@dataclass(frozen=True)
class Light:
    """lamps: directions of equal strength that together make the sun, a window or a ceiling. ambient: share of the
    light that comes from everywhere."""

    kind: str
    lamps: tuple[Direction, ...]
    ambient: float


def light(rng: np.random.Generator) -> Light:
    kind = str(rng.choice(["low sun", "window", "ceiling lamp", "overcast"], p=[0.2, 0.4, 0.2, 0.2]))
    turn = rng.uniform(0, 2 * np.pi)
    low, spread, count, ambient = {
        "low sun": (rng.uniform(22, 45), 1.5, 2, rng.uniform(0.3, 0.5)),
        "window": (rng.uniform(22, 42), 20.0, 6, rng.uniform(0.4, 0.65)),
        "ceiling lamp": (rng.uniform(45, 75), 6.0, 3, rng.uniform(0.35, 0.6)),
        "overcast": (rng.uniform(50, 75), 45.0, 6, rng.uniform(0.6, 0.75)),
    }[kind]
    lamps = []
    for i in range(count):
        angle = turn + np.radians(spread) * (2 * i / (count - 1) - 1)
        up = np.radians(low + 0.5 * spread * rng.uniform(-0.5, 0.5))
        lamps.append((float(np.cos(up) * np.cos(angle)), float(np.cos(up) * np.sin(angle)), float(np.sin(up))))
    return Light(kind, tuple(lamps), float(ambient))


def lit(height: Field, canvas: Canvas, lamp: Light) -> Field:
    """Light that arrives at each pixel; 1 on a flat ground without shadow."""
    dv, du = np.gradient(height, canvas.pixel)
    steep = np.sqrt(1 + du**2 + dv**2)
    direct = np.zeros_like(height)
    for x, y, up in lamp.lamps:
        facing = np.clip((up - x * du - y * dv) / steep, 0, None) / up
        direct += np.minimum(facing, 1.9) * (1 - _shadow(height, canvas, (x, y, up)))
    hollow = cv2.GaussianBlur(height, (0, 0), 0.012 / canvas.pixel) - height  # less of the sky is seen from there
    sky = np.clip(1 - 28 * np.clip(hollow, 0, 0.02), 0.45, 1) / np.sqrt(steep)
    return np.asarray(lamp.ambient * sky + (1 - lamp.ambient) * direct / len(lamp.lamps), np.float32)


def _shadow(height: Field, canvas: Canvas, lamp: Direction) -> Field:
    """0 where the light comes through, 1 where something stands in its way."""
    x, y, up = lamp
    flat = np.hypot(x, y)
    rise = up / flat
    shape = (height.shape[1] // 2, height.shape[0] // 2)  # half as fine is enough
    coarse, pixel = cv2.resize(height, shape, interpolation=cv2.INTER_AREA), 2 * canvas.pixel
    hidden = np.zeros_like(coarse)
    reach = min(FARTHEST, float(coarse.max() - coarse.min()) / rise) / pixel
    step = 1.0
    while step < reach:
        shift = np.float32([[1, 0, -step * x / flat], [0, 1, -step * y / flat]])
        moved = cv2.warpAffine(coarse, shift, shape, borderMode=cv2.BORDER_REPLICATE)
        above = moved - coarse - step * pixel * rise
        hidden = np.maximum(hidden, np.clip(above / (0.0006 + 0.05 * step * pixel), 0, 1))
        step *= 1.25 if step > 4 else 1.5
    return np.asarray(cv2.resize(hidden, height.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def wrinkles(rng: np.random.Generator, canvas: Canvas, strength: float) -> Field:
    """Heights [m] of cloth that was laid by hand: broad waves, pulls, small creases, and sharp folds."""
    height = np.zeros(canvas.shape, np.float32)
    for size, amount, stretch in (
        (0.16, 0.0022, 2.0),
        (0.07, 0.0010, 2.5),
        (0.03, 0.00028, 2.0),
        (0.013, 0.00008, 1.5),
    ):
        scale = size / canvas.pixel
        field = turned(smooth(rng, canvas.shape, (scale, scale * stretch)), rng.uniform(0, np.pi))
        height += strength * rng.uniform(0.5, 1.2) * amount * field
    for _ in range(rng.integers(2, 5)):
        scale = rng.uniform(0.04, 0.09) / canvas.pixel
        field = turned(smooth(rng, canvas.shape, (scale, scale * 5)), rng.uniform(0, np.pi))
        where = np.clip(smooth(rng, canvas.shape, (scale * 2, scale * 2)) - 0.3, 0, 1.2)
        height += strength * 0.0016 * where * np.exp(-((field / 0.16) ** 2))
    return height


def profile(cover: Field, canvas: Canvas, thickness: float) -> Field:
    """Height of a layer above what is below: it rises within about two millimetres of its border."""
    away = cv2.distanceTransform((cover > 0.5).astype(np.uint8), cv2.DIST_L2, 5) * canvas.pixel
    return np.asarray(thickness * (1 - np.exp(-away / 0.0016)), np.float32)
