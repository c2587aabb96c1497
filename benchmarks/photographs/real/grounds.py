"""What a garment lies on at people's homes: desks, floors, beds, carpets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from benchmarks.photographs import table
from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.cloth import relief, wrinkles
from benchmarks.photographs.noise import Field, smooth, turned
from benchmarks.photographs.outline import Points

Drawing = Callable[[np.random.Generator, Canvas], Field]


def across(canvas: Canvas, angle: float) -> tuple[Field, Field]:
    """Two coordinates [m] of each pixel, from the canvas's middle, turned by an angle."""
    v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
    x, y = (u - canvas.shape[1] / 2) * canvas.pixel, (v - canvas.shape[0] / 2) * canvas.pixel
    c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    return c * x + s * y, c * y - s * x


def hue(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> Field:
    """A colour (blue, green, red) of any hue."""
    hsv = np.float32([[[rng.uniform(0, 360), rng.uniform(*saturation), rng.uniform(*value)]]])
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0])


def wood(rng: np.random.Generator, canvas: Canvas) -> Field:
    """A board with a strong grain: long cathedral arches and fibres."""
    base = np.float32([0.24, 0.38, 0.56]) * rng.uniform(0.35, 1.4) * rng.uniform(0.9, 1.1, 3).astype(np.float32)
    return _grain(rng, canvas, base, rng.uniform(0.06, 0.2))


def _grain(rng: np.random.Generator, canvas: Canvas, base: Field, strength: float) -> Field:
    pixel = canvas.pixel
    warp = smooth(rng, canvas.shape, (0.05 / pixel, 0.5 / pixel))
    v = np.mgrid[: canvas.shape[0], : canvas.shape[1]][0].astype(np.float32) * pixel
    phase = v / rng.uniform(0.008, 0.03) + rng.uniform(0.8, 2.5) * warp
    rings = np.abs(np.mod(phase, 1) - 0.5) * 2
    fibre = smooth(rng, canvas.shape, (1.5, 0.08 / pixel))
    factor = 1 + strength * (0.6 * (rings**2 - 0.4) + 0.25 * fibre + 0.15 * warp)
    factor = turned(factor.astype(np.float32), rng.normal(0, 0.1) + rng.integers(2) * np.pi / 2)
    return np.asarray(np.clip(base * factor[..., None] ** np.float32([1.3, 1.1, 0.9]), 0, 1), np.float32)


def laminate_boards(rng: np.random.Generator, canvas: Canvas) -> Field:
    """A floor of boards that are laid staggered; each board has its own shade and grain."""
    a, b = across(canvas, rng.normal(0, 0.06) + rng.integers(2) * np.pi / 2)
    width, length = rng.uniform(0.06, 0.19), rng.uniform(0.35, 1.2)
    row = np.floor(b / width + 50).astype(int)
    shift = rng.uniform(0, length, row.max() + 1)
    along = a + shift[row]
    column = np.floor(along / length + 50).astype(int)
    number = row * 131 + column
    shades = rng.normal(0, rng.uniform(0.03, 0.12), number.max() + 1).astype(np.float32)[number]
    base = np.float32([0.55, 0.66, 0.74]) * rng.uniform(0.35, 1.15) * rng.uniform(0.93, 1.07, 3).astype(np.float32)
    colours = _grain(rng, canvas, base, rng.uniform(0.05, 0.14)) * (1 + shades)[..., None]
    joint = np.minimum(
        np.minimum(np.mod(b, width), width - np.mod(b, width)),
        np.minimum(np.mod(along, length), length - np.mod(along, length)),
    )
    dark = 1 - rng.uniform(0.15, 0.5) * np.exp(-((joint / max(0.0011, 0.7 * canvas.pixel)) ** 2))
    return np.asarray(colours * dark[..., None], np.float32)


def tiles(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Tiles with grout: each has its own shade, some a marbled one."""
    a, b = across(canvas, rng.normal(0, 0.08) + rng.integers(2) * np.pi / 4)
    size = rng.choice([0.1, 0.2, 0.3, 0.45]) * rng.uniform(0.9, 1.1)
    row, column = (np.floor(f / size + 60).astype(int) for f in (a, b))
    number = row * 131 + column
    shades = rng.normal(0, 0.03, number.max() + 1).astype(np.float32)[number]
    base = hue(rng, (0.02, 0.3), (0.3, 0.9))
    marble = smooth(rng, canvas.shape, (0.05 / canvas.pixel, 0.09 / canvas.pixel))
    colours = base * (1 + shades + rng.uniform(0, 0.06) * marble)[..., None]
    if rng.random() < 0.25:  # a chequerboard
        colours = np.where((np.mod(row + column, 2) == 0)[..., None], colours, colours * rng.uniform(0.45, 0.8))
    grout = np.minimum(*(np.minimum(np.mod(f, size), size - np.mod(f, size)) for f in (a, b)))
    cover = np.clip((rng.uniform(0.0015, 0.004) - grout) / canvas.pixel + 0.5, 0, 1)[..., None]
    return np.asarray(colours + cover * (base * rng.choice([0.5, 0.7, 1.25]) - colours), np.float32)


def carpet(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Pile of several yarns; some carpets have a woven border or a large motif."""
    base = hue(rng, (0.05, 0.5), (0.2, 0.8))
    pile = smooth(rng, canvas.shape, (2.2, 2.2)) * rng.uniform(0.05, 0.14)
    trodden = smooth(rng, canvas.shape, (0.12 / canvas.pixel, 0.2 / canvas.pixel)) * rng.uniform(0.02, 0.07)
    colours = base * (1 + pile + trodden)[..., None]
    if rng.random() < 0.45:
        second = np.clip(base * rng.uniform(0.4, 1.7) + rng.normal(0, 0.08, 3), 0.03, 0.9).astype(np.float32)
        a, b = across(canvas, rng.normal(0, 0.1) + rng.integers(2) * np.pi / 4)
        size = rng.uniform(0.06, 0.2)
        cell = np.abs(np.mod(a, size) / size - 0.5) + np.abs(np.mod(b, size) / size - 0.5)
        motif = (np.mod(cell * rng.uniform(2, 4), 1) < 0.4).astype(np.float32)
        motif = cv2.GaussianBlur(motif, (0, 0), 1.5)[..., None] * rng.uniform(0.3, 0.9)
        colours = colours + motif * (second * (1 + pile)[..., None] - colours)
    return np.asarray(colours, np.float32)


def bed(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Bed linen that is not smooth: folds, and often a pattern of stripes, checks, leaves or dots."""
    base = hue(rng, (0.0, 0.35), (0.55, 0.93)) if rng.random() < 0.8 else hue(rng, (0.2, 0.7), (0.15, 0.5))
    second = np.clip(base * rng.uniform(0.45, 0.85) + rng.normal(0, 0.06, 3), 0.03, 0.95).astype(np.float32)
    folds = wrinkles(rng, canvas)
    bend = cv2.GaussianBlur(folds, (0, 0), 0.02 / canvas.pixel) * 0.004  # a fold displaces the pattern
    a, b = across(canvas, rng.uniform(0, np.pi))
    a, b = a + bend, b - bend
    kind, size = rng.integers(5), rng.uniform(0.02, 0.09)
    share = np.zeros(canvas.shape, np.float32)
    if kind == 1:
        share = _soft(np.mod(a, size) < size * rng.uniform(0.15, 0.5))
    elif kind == 2:
        share = (_soft(np.mod(a, size) < size * 0.4) + _soft(np.mod(b, size) < size * 0.4)) / 2
    elif kind == 3:
        grown = smooth(rng, canvas.shape, (size / canvas.pixel, size / canvas.pixel))
        share = _soft(grown + 0.5 * np.sin(a * 40) > rng.uniform(0.4, 1.0))
    elif kind == 4:
        share = _soft((np.mod(a, size) / size - 0.5) ** 2 + (np.mod(b, size) / size - 0.5) ** 2 < 0.06)
    colours = base + share[..., None] * rng.uniform(0.4, 1.0) * (second - base)
    angle = rng.uniform(0, 2 * np.pi)
    shade = relief(folds, canvas, np.array([np.cos(angle), np.sin(angle)]))
    weave = smooth(rng, canvas.shape, (1.5, 1.5)) * 0.012
    return np.asarray(colours * (1 + weave + np.clip(rng.uniform(0.03, 0.08) * shade, -0.3, 0.2))[..., None])


def _soft(inside: np.ndarray) -> Field:
    return cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 1.0)


def striped(rng: np.random.Generator, canvas: Canvas) -> Field:
    """A table cloth or a blanket with strong stripes."""
    base = hue(rng, (0.05, 0.6), (0.3, 0.9))
    second = np.clip(base * rng.uniform(0.3, 1.6) + rng.normal(0, 0.12, 3), 0.03, 0.95).astype(np.float32)
    a, b = across(canvas, rng.normal(0, 0.15) + rng.integers(2) * np.pi / 2)
    a = a + 0.002 * smooth(rng, canvas.shape, (0.2 / canvas.pixel, 0.2 / canvas.pixel))
    period = rng.uniform(0.02, 0.12)
    share = _soft(np.mod(a, period) < period * rng.uniform(0.3, 0.6))
    if rng.random() < 0.3:
        share = (share + _soft(np.mod(b, period) < period * 0.4)) / 2
    weave = smooth(rng, canvas.shape, (1.5, 1.5)) * 0.03
    return np.asarray((base + share[..., None] * (second - base)) * (1 + weave)[..., None], np.float32)


def white(rng: np.random.Generator, canvas: Canvas) -> Field:
    """A white desk or sheet."""
    base = np.float32(rng.uniform(0.78, 0.9) * np.ones(3)) * np.float32([rng.uniform(0.94, 1.0), 0.99, 1.0])
    factor = 1 + 0.006 * smooth(rng, canvas.shape, (2, 2)) + 0.01 * smooth(rng, canvas.shape, (150, 150))
    if rng.random() < 0.5:
        shade = relief(wrinkles(rng, canvas), canvas, np.array([0.6, 0.8]))
        factor = factor + np.clip(0.015 * shade, -0.06, 0.06)
    return np.asarray(base * factor[..., None], np.float32)


def desk(rng: np.random.Generator, canvas: Canvas) -> Field:
    drawing: Drawing = (wood, table.wood_photograph, table.laminate, laminate_boards)[rng.integers(4)]
    return drawing(rng, canvas)


def desk_edge(rng: np.random.Generator, canvas: Canvas, outline: Points) -> Field:
    """A desk whose edge runs through the picture, beside the garment, and the floor beyond, farther away."""
    top = desk(rng, canvas)
    farther = replace(canvas, pixel=canvas.pixel * rng.uniform(1.5, 2.0))
    below = (laminate_boards, carpet, tiles)[rng.integers(3)](rng, farther)
    below = cv2.GaussianBlur(below, (0, 0), rng.uniform(1.0, 3.0)) * rng.uniform(0.4, 1.0)
    pixels = canvas.at(outline)
    sides = rng.permutation(4)[: 1 if rng.random() < 0.75 else 2]
    for side in sides:
        angle = side * np.pi / 2 + rng.normal(0, 0.06)
        out = np.array([np.cos(angle), np.sin(angle)])
        at = float((pixels @ out).max()) + rng.uniform(0.012, 0.06) / canvas.pixel
        v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
        beyond = (u * np.float32(out[0]) + v * np.float32(out[1]) - np.float32(at)) * canvas.pixel
        cover = np.clip(beyond / canvas.pixel + 0.5, 0, 1)[..., None]
        rim = rng.uniform(0.004, 0.03)
        shaded = below * (1 - 0.55 * np.exp(-np.clip(beyond - rim, 0, None) / 0.06))[..., None]
        side_of_desk = top * rng.uniform(0.4, 0.8)
        shown = np.where((beyond < rim)[..., None], side_of_desk, shaded)
        top = top + cover * (shown - top)
    return np.asarray(top, np.float32)


def sun(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Factor (rows, columns, 3) of light through a window: bright panes with bars between them, light broken by
    leaves, or the edge of a shadow."""
    kind = rng.choice(["panes", "leaves", "edge"], p=[0.5, 0.25, 0.25])
    a, b = across(canvas, rng.uniform(0, np.pi))
    extent = max(canvas.shape) * canvas.pixel
    if kind == "panes":
        slanted = b + rng.uniform(-0.6, 0.6) * a
        wide, high, bar = rng.uniform(0.1, 0.3), rng.uniform(0.12, 0.4), rng.uniform(0.015, 0.04)
        a0, b0 = rng.uniform(-0.5, 0.2, 2) * extent
        columns, rows = rng.integers(1, 4, 2)
        pa, pb = (a - a0) / wide, (slanted - b0) / high
        inside = (pa > 0) & (pa < columns) & (pb > 0) & (pb < rows)
        inside &= (np.mod(pa, 1) * wide > bar) & (np.mod(pb, 1) * high > bar)
    elif kind == "leaves":
        size = rng.uniform(0.03, 0.08) / canvas.pixel
        inside = smooth(rng, canvas.shape, (size, size * rng.uniform(1, 2))) > rng.uniform(0.2, 0.9)
    else:
        inside = a + rng.uniform(-0.3, 0.3) * extent > 0.15 * smooth(
            rng, canvas.shape, (canvas.shape[0] / 2, canvas.shape[1] / 2)
        ) * rng.choice([0.0, 1.0])
    lit = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), rng.uniform(0.0015, 0.008) / canvas.pixel)
    soft = kind == "leaves"  # broken light is scattered light
    dim = rng.uniform(0.7, 0.9) if soft else rng.uniform(0.5, 0.85)
    bright = dim * (rng.uniform(1.2, 1.7) if soft else rng.uniform(1.5, 2.6)) * np.float32([0.86, 0.96, 1.06])
    return np.asarray(dim + lit[..., None] * (bright - dim), np.float32)


GROUNDS: dict[str, Drawing] = {
    "plain": lambda rng, canvas: table.draw_table(rng, canvas)[1],
    "sun": desk,
    "wood": wood,
    "boards": laminate_boards,
    "desk_edge": desk,
    "bed": bed,
    "carpet": carpet,
    "tiles": tiles,
    "white": white,
    "striped": striped,
    "busy": desk,
}
"""By name. The light of "sun" and the edge of "desk_edge" are drawn once the garment's place is known."""
