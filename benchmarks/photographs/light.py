"""Light on the table: uneven lamps, shadows of the garment and of things outside the picture, highlights."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.noise import Field, smooth
from benchmarks.photographs.outline import Points


def random_light(rng: np.random.Generator) -> Points:
    """Direction (column, row) in which the light runs over the canvas, of unit length."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def ambient(rng: np.random.Generator, canvas: Canvas, light: Points) -> Field:
    """Factor (rows, columns, 3): fall-off away from the lamp, its colour, and a large soft shadow on half of the
    tables."""
    rows, columns = canvas.shape
    v, u = np.mgrid[:rows, :columns].astype(np.float32)
    along = ((u - columns / 2) * light[0] + (v - rows / 2) * light[1]) / max(rows, columns)
    factor = 1 - rng.uniform(0.0, 0.4) * along + 0.02 * smooth(rng, canvas.shape, (300, 300))
    if rng.random() < 0.5:
        angle = rng.uniform(0, 2 * np.pi)
        edge = (u - columns / 2) * np.cos(angle) + (v - rows / 2) * np.sin(angle)
        away = (edge * canvas.pixel - rng.uniform(0.15, 0.6)) / rng.uniform(0.03, 0.15)
        factor = factor * (1 - rng.uniform(0.08, 0.30) / (1 + np.exp(-np.clip(away, -20, 20))))
    warmth = rng.normal(0, 0.04)
    colour = np.float32([1 - warmth, 1.0, 1 + warmth]) * rng.uniform(0.8, 1.1)
    return np.asarray(factor[..., None] * colour, np.float32)


def cast_shadow(mask: Field, canvas: Canvas, light: Points, height: float, depth: float) -> Field:
    """Factor of the shadow that a thing of that height [m] throws, soft at its border."""
    shift = np.float32([[1, 0, light[0] * height / canvas.pixel], [0, 1, light[1] * height / canvas.pixel]])
    moved = cv2.warpAffine(mask, shift, mask.shape[::-1])
    return np.asarray(
        1 - depth * cv2.GaussianBlur(moved, (0, 0), max(0.8, 0.6 * height / canvas.pixel)), np.float32
    )


def highlight(rng: np.random.Generator, canvas: Canvas) -> Field:
    """Light that a glossy table reflects, to be added; none on many tables."""
    if rng.random() < 0.6:
        return np.zeros(canvas.shape, np.float32)
    rows, columns = canvas.shape
    v, u = np.mgrid[:rows, :columns].astype(np.float32)
    size = rng.uniform(0.08, 0.25) / canvas.pixel
    du, dv = (u - rng.uniform(0, columns)) / size, (v - rng.uniform(0, rows)) / (size * rng.uniform(0.6, 1.5))
    return np.asarray(rng.uniform(0.05, 0.22) * np.exp(-(du**2 + dv**2) / 2), np.float32)
