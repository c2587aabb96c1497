"""The look of a garment on the canvas: colours, patterns, seams, wrinkles and the light on them."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.noise import Field, smooth, turned
from benchmarks.photographs.outline import Points

Colour = Field
"""(3,) blue, green, red; 0 to 1."""

MIN_CONTRAST = 14.0
"""Smallest distance (CIELAB) between the cloth's main colour and the table's: below it a person
would lay the garment elsewhere."""


def lab(colour: Colour) -> Field:
    return np.asarray(cv2.cvtColor(colour.reshape(1, 1, 3).astype(np.float32), cv2.COLOR_BGR2LAB)[0, 0])


def cloth_colour(rng: np.random.Generator, table: Colour) -> Colour:
    """White, black, near the table's colour, or any dye; with `MIN_CONTRAST` to the table."""
    while True:
        kind = rng.random()
        if kind < 0.15:
            colour = np.full(3, rng.uniform(0.80, 0.93)) * rng.uniform(0.97, 1.0, 3)
        elif kind < 0.30:
            colour = np.full(3, rng.uniform(0.05, 0.12)) * rng.uniform(0.9, 1.1, 3)
        elif kind < 0.45:
            colour = np.clip(table * rng.uniform(0.65, 1.3) + rng.normal(0, 0.05, 3), 0.03, 0.95)
        else:
            hue, saturation, value = rng.uniform(0, 360), rng.uniform(0.1, 0.85), rng.uniform(0.2, 0.9)
            colour = cv2.cvtColor(np.float32([[[hue, saturation, value]]]), cv2.COLOR_HSV2BGR)[0, 0]
        colour = np.asarray(colour, np.float32)
        if np.linalg.norm(lab(colour) - lab(table)) >= MIN_CONTRAST:
            return colour


def pattern(
    rng: np.random.Generator, canvas: Canvas, main: Colour, middle: Points, angle: float
) -> tuple[str, Field]:
    """Colours of an endless cloth on the canvas; most of it is `main`. middle, angle: place of the garment."""
    second = np.clip(main + rng.choice([-1, 1]) * rng.uniform(0.12, 0.45) + rng.normal(0, 0.1, 3), 0.03, 0.95)
    column, row = canvas.at(middle[None])[0]
    v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
    x, y = (v - row) * canvas.pixel, (u - column) * canvas.pixel
    along = np.cos(angle) * x - np.sin(angle) * y
    across = np.sin(angle) * x + np.cos(angle) * y
    kind = str(rng.choice(["plain", "stripes", "checks", "print", "dots"], p=[0.50, 0.17, 0.13, 0.12, 0.08]))
    share = np.zeros(canvas.shape, np.float32)
    if kind == "stripes":
        period, width = rng.uniform(0.012, 0.06), rng.uniform(0.2, 0.45)
        share = band(along if rng.random() < 0.6 else across, period, width)
    elif kind == "checks":
        period, width = rng.uniform(0.015, 0.07), rng.uniform(0.2, 0.45)
        share = (band(along, period, width) + band(across, period, width)) / 2
    elif kind == "print":
        share = picture_print(rng, along, across)
    elif kind == "dots":
        period = rng.uniform(0.02, 0.05)
        a, b = (np.mod(field, period) / period - 0.5 for field in (along, across))
        share = (a**2 + b**2 < 0.07).astype(np.float32)
    return kind, main + share[..., None] * (second.astype(np.float32) - main)


def band(field: Field, period: float, width: float) -> Field:
    return np.asarray(np.mod(field, period) < width * period, np.float32)


def picture_print(rng: np.random.Generator, along: Field, across: Field) -> Field:
    """A motif on the middle of the cloth: rings, a box, or lines as of text."""
    size = rng.uniform(0.04, 0.09)
    radius = np.hypot(along, across)
    kind = rng.integers(3)
    if kind == 0:
        return np.asarray((radius < size) & (np.mod(radius, size / 2) < size / 3), np.float32)
    box = (np.abs(along) < size) & (np.abs(across) < size * rng.uniform(0.7, 1.2))
    if kind == 1:
        return np.asarray(box & (along + 0.5 * np.abs(across) > 0), np.float32)
    letters = np.mod(across, 0.017) < 0.011
    return np.asarray(box & (np.mod(along, 0.035) < 0.018) & letters, np.float32)


def wrinkles(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Heights in some unit: broad waves and a few creases."""
    scale = rng.uniform(0.05, 0.12) / canvas.pixel
    waves = turned(smooth(rng, canvas.shape, (scale, scale * rng.uniform(1.5, 4))), rng.uniform(0, np.pi))
    fine = smooth(rng, canvas.shape, (scale / 3, scale / 3))
    creases = turned(smooth(rng, canvas.shape, (scale / 2, scale * 4)), rng.uniform(0, np.pi))
    return np.asarray(waves + 0.15 * fine + 0.5 * np.abs(creases), np.float32)


def relief(height: Field, canvas: Canvas, light: Points) -> Field:
    """Brightness of the slopes in light from the side: 0 on the flat, deviation 1."""
    slope = cv2.GaussianBlur(height, (0, 0), 0.004 / canvas.pixel)
    dv, du = np.gradient(slope)
    shade = du * light[0] + dv * light[1]
    return np.asarray(shade / max(float(shade.std()), 1e-9), np.float32)


def inwards(line: Points, middle: Points, inset: float) -> Points:
    """The line moved towards the middle by `inset` across itself."""
    along = np.gradient(line, axis=0)
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    sign = np.sign(np.sum((middle - line.mean(axis=0)) * normal.mean(axis=0)))
    return np.asarray(line + sign * inset * normal)


def over(below: Field, cover: Field, colour: Colour) -> Field:
    """A colour laid over a picture where `cover` is 1."""
    return np.asarray(below + cover[..., None] * (colour - below), np.float32)
