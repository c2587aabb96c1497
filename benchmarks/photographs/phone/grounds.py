"""What the garment lies on: its colour (blue, green, red; linear light) and its height [m]."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from benchmarks.photographs import table
from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.noise import Field, smooth
from benchmarks.photographs.phone.relief import wrinkles
from benchmarks.photographs.real import grounds as boards
from benchmarks.photographs.real.grounds import Drawing, across, hue

Ground = tuple[Field, Field]


def linear(colour: Field) -> Field:
    """Light of a colour as a screen shows it."""
    return np.asarray(np.clip(colour, 0, 1) ** 2.2, np.float32)


def hard(
    drawing: Drawing, shade: float = 1.0, colour: float = 1.0
) -> Callable[[np.random.Generator, Canvas], Ground]:
    """A hard ground by its colours; its dark lines are its joints, and lie lower."""

    def drawn(rng: np.random.Generator, canvas: Canvas) -> Ground:
        colours = drawing(rng, canvas)
        bright = colours.mean(axis=2)
        lower = np.clip(bright / np.maximum(cv2.GaussianBlur(bright, (0, 0), 6), 0.01) - 0.93, -0.5, 0)
        return linear(shade * (bright[..., None] + colour * (colours - bright[..., None]))), np.float32(
            0.0012 * lower
        )

    return drawn


def sheet(rng: np.random.Generator, canvas: Canvas) -> Ground:
    """Bed linen with wrinkles; some is striped or printed."""
    height = wrinkles(rng, canvas, rng.uniform(0.6, 1.8))
    base = hue(rng, (0.0, 0.25), (0.7, 0.95)) if rng.random() < 0.7 else hue(rng, (0.1, 0.45), (0.25, 0.75))
    second = np.float32(base * rng.uniform(0.5, 0.85) + rng.normal(0, 0.05, 3))
    a, b = across(canvas, rng.uniform(0, np.pi))
    size, kind = rng.uniform(0.015, 0.08), rng.integers(4)
    share = np.zeros(canvas.shape, np.float32)
    if kind == 1:
        share = (np.mod(a + height, size) < 0.3 * size).astype(np.float32)
    elif kind == 2:
        grain = (size / canvas.pixel, size / canvas.pixel)
        share = (smooth(rng, canvas.shape, grain) * smooth(rng, canvas.shape, grain) > 0.5).astype(np.float32)
    share = cv2.GaussianBlur(share, (0, 0), 1.0)[..., None] * rng.uniform(0.4, 0.9)
    return linear(base + share * (second - base)) * _thread(rng, canvas, a, b), height


def carpet(rng: np.random.Generator, canvas: Canvas) -> Ground:
    """Pile, short or shaggy."""
    deep = rng.uniform(1, 5)
    fibres = smooth(rng, canvas.shape, (1.3 * deep**0.5, 1.3 * deep**0.5))
    trodden = smooth(rng, canvas.shape, (0.1 / canvas.pixel, 0.16 / canvas.pixel))
    yarn = 1 + 0.10 * smooth(rng, canvas.shape, (2, 2)) + 0.05 * trodden + 0.08 * fibres
    colours = linear(hue(rng, (0.03, 0.5), (0.2, 0.82))) * yarn[..., None]
    return colours, np.float32(0.00012 * deep * fibres + 0.0012 * trodden)


def ironing(rng: np.random.Generator, canvas: Canvas) -> Ground:
    """The padded cover of a wide ironing board: quilted, in any colour, with its rim and the floor beyond."""
    a, b = across(canvas, rng.normal(0, 0.06) + rng.integers(2) * np.pi / 2)
    size = rng.uniform(0.03, 0.07)
    quilt = np.minimum(*(np.abs(np.mod(f, size) - size / 2) for f in (a + b, a - b)))
    base = linear(hue(rng, (0.0, 0.12), (0.6, 0.82)) if rng.random() < 0.6 else hue(rng, (0.2, 0.6), (0.35, 0.8)))
    cover = base * _thread(rng, canvas, a, b)
    beyond, low = hard(boards.laminate_boards, 0.7)(rng, canvas)
    rim = rng.choice([-1, 1]) * b - (0.5 * np.ptp(b) - rng.uniform(0.03, 0.1))
    share = np.clip(rim / canvas.pixel + 0.5, 0, 1)
    height = 0.0012 * (1 - np.exp(-quilt / 0.004)) + 0.003 * np.exp(-((rim / 0.004) ** 2)) + share * (low - 0.03)
    return cover + share[..., None] * (beyond - cover), np.float32(height)


def _thread(rng: np.random.Generator, canvas: Canvas, a: Field, b: Field) -> Field:
    """Factor of warp and weft."""
    weave = np.sin(a * 2 * np.pi / 0.0031) * np.sin(b * 2 * np.pi / 0.0031)
    return np.asarray(1 + 0.02 * (weave + smooth(rng, canvas.shape, (1.5, 1.5))))[..., None]


GROUNDS: dict[str, Callable[[np.random.Generator, Canvas], Ground]] = {
    "floor": hard(boards.laminate_boards), "laminate": hard(table.laminate), "wood": hard(boards.wood),
    "sheet": sheet, "carpet": carpet, "tiles": hard(boards.tiles, 1.0, 0.4), "ironing board": ironing,
    "dark table": hard(boards.wood, 0.35),
}  # fmt: skip
