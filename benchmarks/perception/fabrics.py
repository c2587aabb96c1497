"""Draws fabrics and light of the labelled scenes, with more variety than in the cell's simulated world."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.simulation.garment.fabric import SIZE, TABLE_HSV, contrasting_colour, fabric_texture
from foldcell.robots.ports import Array

Texture = NDArray[np.uint8]

LEAST_DIFFERENCE = 15.0
"""Minimum difference between at least 95 % of a fabric's pixels and the table's mean colour [CIE 1976 delta E]."""
LOOKS = ("contrast", "table_hue", "neutral", "stripes", "checks")
SHARES = (0.35, 0.15, 0.20, 0.15, 0.15)


def draw_fabric(rng: np.random.Generator, surface: str, table: Texture) -> tuple[Texture, str, float]:
    """Draw a fabric. Return its texture (SIZE, SIZE, 3) RGB, the name of its appearance, and its colour difference
    from the table [CIE 1976 delta E]."""
    for _ in range(200):
        look = str(rng.choice(LOOKS, p=SHARES))
        texture = _fabric(rng, look, surface)
        difference = colour_difference(texture, table)
        if difference >= LEAST_DIFFERENCE:
            return texture, look, difference
    raise RuntimeError(f"no fabric differs from {surface} by {LEAST_DIFFERENCE}")


def colour_difference(texture: Texture, table: Texture) -> float:
    """5th percentile of the CIE 1976 delta E between the fabric's pixels and the table's mean colour."""
    away = np.linalg.norm(_lab(texture)[::4, ::4] - _lab(table).reshape(-1, 3).mean(axis=0), axis=-1)
    return float(np.quantile(away, 0.05))


def _lab(rgb: Texture) -> Array:
    return np.asarray(cv2.cvtColor(rgb.astype(np.float32) / 255.0, cv2.COLOR_RGB2LAB), dtype=np.float64)


def _fabric(rng: np.random.Generator, look: str, surface: str) -> Texture:
    if look == "contrast":
        return fabric_texture(rng, contrasting_colour(rng))
    if look == "table_hue":  # slightly lighter or darker
        hue, saturation, value = TABLE_HSV[surface]
        return fabric_texture(rng, (hue, saturation, value + rng.choice([-45.0, 45.0])))
    weave = cv2.GaussianBlur(rng.standard_normal((SIZE, SIZE)), (0, 0), 0.8)
    weave *= 5.0 / weave.std()
    if look == "neutral":
        level = float(rng.choice([35.0, 60.0, 210.0, 235.0])) + rng.uniform(-10, 10)
        return np.clip(level + weave[..., None] + rng.uniform(-3, 3, 3), 0, 255).astype(np.uint8)
    u = np.linspace(0.0, 1.0, SIZE, endpoint=False)
    bands = (np.sin(2 * np.pi * rng.uniform(3, 14) * u + rng.uniform(0, 6)) > rng.uniform(-0.5, 0.5)).astype(float)
    where = np.broadcast_to(bands[:, None], (SIZE, SIZE))
    if look == "checks":
        where = 0.5 * (where + where.T)
    elif rng.random() < 0.5:
        where = where.T
    a, b = (np.asarray(_colour(rng), dtype=float) for _ in range(2))
    return np.clip(a + where[..., None] * (b - a) + weave[..., None], 0, 255).astype(np.uint8)


def _colour(rng: np.random.Generator) -> NDArray[np.uint8]:
    hsv = np.uint8([[[rng.integers(180), rng.integers(20, 220), rng.integers(40, 235)]]])
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), dtype=np.uint8)[0, 0]


@dataclass(frozen=True)
class Light:
    """Light on the table besides the renderer's lamp.

    slope: relative change of light from the picture's middle to its right and its lower border. The other values
    describe a soft shadow that is missing in the picture of the empty table. shade: its depth (0: no shadow).
    centre: (column, row), and size, both relative to the picture.
    """

    slope: tuple[float, float]
    shade: float
    centre: tuple[float, float]
    size: float

    @staticmethod
    def draw(rng: np.random.Generator) -> Light:
        slope = rng.uniform(-0.12, 0.12, 2)
        shade = float(rng.uniform(0.10, 0.30)) if rng.random() < 0.3 else 0.0
        u, v = rng.uniform(0.0, 1.0, 2)
        size = float(rng.uniform(0.15, 0.4))
        return Light((float(slope[0]), float(slope[1])), shade, (float(u), float(v)), size)

    def on(self, rgb: Texture, shaded: bool) -> Texture:
        """Return the picture rgb (h, w, 3) in this light. shaded: whether to add the soft shadow."""
        h, w = rgb.shape[:2]
        v, u = np.mgrid[0:h, 0:w].astype(np.float32)
        u, v = u / w, v / h
        gain = 1.0 + 2 * self.slope[0] * (u - 0.5) + 2 * self.slope[1] * (v - 0.5)
        if shaded and self.shade > 0:
            r = np.hypot(u - self.centre[0], (v - self.centre[1]) * h / w) / self.size
            gain *= 1.0 - self.shade / (1.0 + np.exp(np.clip(8.0 * (r - 1.0), -30, 30)))
        return np.clip(np.rint(rgb * gain[..., None]), 0, 255).astype(np.uint8)
