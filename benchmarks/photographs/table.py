"""What the garment lies on: wood (from a photograph or drawn), laminate, or a table cloth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pybullet_data

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.noise import Field, smooth, turned

WOOD_PHOTOGRAPH = Path(pybullet_data.getDataPath()) / "table" / "table.png"
"""A photograph of birch, which PyBullet (zlib licence) ships. Its longer side shows about 1.2 m."""


def draw_table(rng: np.random.Generator, canvas: Canvas) -> tuple[str, Field]:
    """Name and colours of a table that fills the canvas."""
    kind = str(rng.choice(["wood photograph", "wood", "laminate", "cloth"], p=[0.30, 0.25, 0.25, 0.20]))
    drawing = {"wood photograph": wood_photograph, "wood": wood, "laminate": laminate, "cloth": table_cloth}[kind]
    return kind, drawing(rng, canvas)


def wood_photograph(rng: np.random.Generator, canvas: Canvas) -> Field:
    """The photograph, stained: darker and redder by chance."""
    photo = cv2.imread(str(WOOD_PHOTOGRAPH)).astype(np.float32) / 255
    scale = photo.shape[1] / 1.2 * canvas.pixel
    v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
    angle = rng.normal(0, 0.05) + rng.integers(2) * np.pi / 2
    x = scale * (np.cos(angle) * u + np.sin(angle) * v) + rng.uniform(0, 500)
    y = scale * (-np.sin(angle) * u + np.cos(angle) * v) + rng.uniform(0, 500)
    seen = cv2.remap(
        photo, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    depth = rng.uniform(1.0, 2.6)
    grain = seen / cv2.GaussianBlur(seen, (0, 0), 40)
    stained = np.clip(seen, 0.01, 1) ** depth * grain ** rng.uniform(1, 4)
    return np.asarray(np.clip(stained * [rng.uniform(0.8, 1), 1, 1], 0, 1), np.float32)


def wood(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Drawn wood: long fibres, growth rings, and boards beside each other on some tables."""
    base = np.float32([0.25, 0.40, 0.58]) * rng.uniform(0.45, 1.35)
    base = base * rng.uniform(0.9, 1.1, 3).astype(np.float32)
    fibre = smooth(rng, canvas.shape, (2, 90)) * 0.035
    warp = smooth(rng, canvas.shape, (60, 400))
    v = np.mgrid[: canvas.shape[0], : canvas.shape[1]][0]
    rings = np.sin(v * canvas.pixel * 2 * np.pi / rng.uniform(0.015, 0.04) + 3 * warp) * rng.uniform(0.01, 0.06)
    factor = 1 + fibre + rings + 0.03 * warp
    if rng.random() < 0.5:
        board = rng.uniform(0.09, 0.16) / canvas.pixel
        number = (v / board).astype(int)
        factor = factor * (1 + 0.06 * rng.standard_normal(number.max() + 1)[number])
        factor = np.where(np.mod(v, board) < max(1.5, 0.002 / canvas.pixel), factor * 0.6, factor)
    factor = turned(factor.astype(np.float32), rng.normal(0, 0.04) + rng.integers(2) * np.pi / 2)
    return np.asarray(base * factor[..., None], np.float32)


def laminate(rng: np.random.Generator, canvas: Canvas) -> Field:
    """White, grey, beige or dark board with faint specks."""
    base = np.float32(rng.choice([0.85, 0.65, 0.45, 0.2])) * np.float32([rng.uniform(0.85, 1.02), 0.97, 1.0])
    specks = smooth(rng, canvas.shape, (2.5, 2.5)) * rng.uniform(0.005, 0.03)
    clouds = smooth(rng, canvas.shape, (150, 150)) * 0.01
    return np.asarray(base * (1 + specks + clouds)[..., None], np.float32)


def table_cloth(rng: np.random.Generator, canvas: Canvas) -> Field:
    """A smooth table cloth: weave, and on some a faint check."""
    hue, saturation, value = rng.uniform(0, 360), rng.uniform(0.05, 0.5), rng.uniform(0.3, 0.85)
    base = cv2.cvtColor(np.float32([[[hue, saturation, value]]]), cv2.COLOR_HSV2BGR)[0, 0]
    factor = 1 + smooth(rng, canvas.shape, (1.5, 1.5)) * 0.03 + smooth(rng, canvas.shape, (120, 120)) * 0.015
    if rng.random() < 0.4:
        period = rng.uniform(0.03, 0.08) / canvas.pixel
        v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]]
        checks = (np.mod(v, period) < period / 2).astype(float) + (np.mod(u, period) < period / 2)
        factor = factor * (1 - rng.uniform(0.02, 0.12) * checks)
    return np.asarray(base * factor[..., None], np.float32)
