"""Things that lie close to a garment where people live: books, shoes, a laptop, other clothes."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.clutter import THINGS, Parts
from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points
from benchmarks.photographs.real.grounds import hue

NEAR = 0.012
"""Smallest distance [m] from the garment."""
FEWEST, MOST = 5, 11
"""Things that are tried; some find no place."""


def book(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    frame = _frame(rng, at, rng.uniform(0.07, 0.11), rng.uniform(0.1, 0.15))
    cover = hue(rng, (0.1, 0.9), (0.15, 0.9))
    return [
        (canvas.mask(frame(1.0, 1.0)), cover, 0.02),
        (canvas.mask(frame(0.25, 0.7)), hue(rng, (0, 0.4), (0.6, 0.95)), 0.0),
    ]


def laptop(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    frame = _frame(rng, at, 0.115, 0.165)
    shell = np.float32(np.ones(3) * rng.choice([0.1, 0.45, 0.7]))
    return [
        (canvas.mask(frame(1.0, 1.0)), shell, 0.02),
        (canvas.mask(frame(0.6, 0.9)), shell * 0.35, 0.0),
        (canvas.mask(frame(0.1, 0.3)), shell * 0.8, 0.0),
    ]


def paper(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    frame = _frame(rng, at, 0.105, 0.148)
    parts: Parts = [(canvas.mask(frame(1.0, 1.0)), np.float32([0.9, 0.92, 0.93]), 0.002)]
    corners = frame(0.8, 0.75)
    for t in np.linspace(0.05, 0.95, 14):
        ends = np.array([corners[0] + t * (corners[1] - corners[0]), corners[3] + t * (corners[2] - corners[3])])
        parts.append((0.6 * canvas.line(ends, 0.002), np.float32([0.3, 0.3, 0.3]), 0.0))
    return parts


def shoe(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    turn = np.linspace(0, 2 * np.pi, 60)
    angle, colour = rng.uniform(0, 2 * np.pi), hue(rng, (0.0, 0.8), (0.08, 0.9))
    matrix = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def sole(scale: float, shift: float) -> Points:
        x = 0.14 * scale * np.cos(turn) + shift
        y = 0.045 * scale * np.sin(turn) * (1 + 0.22 * np.cos(turn - 0.5))
        return np.asarray(np.column_stack([x, y]) @ matrix + at)

    return [
        (canvas.mask(sole(1.0, 0.0)), np.float32([0.85, 0.87, 0.88]), 0.03),
        (canvas.mask(sole(0.92, 0.0)), colour, 0.0),
        (canvas.mask(sole(0.4, -0.06)), colour * 0.25, 0.0),
    ]


def hanger(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    angle = rng.uniform(0, 2 * np.pi)
    matrix = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    frame = np.array([[0.0, -0.2], [0.09, 0.0], [0.0, 0.2], [0.0, -0.2]]) @ matrix + at
    hook = np.array([[0.09, 0.0], [0.13, 0.0], [0.16, 0.015], [0.15, 0.035]]) @ matrix + at
    colour = hue(rng, (0.0, 0.5), (0.1, 0.8))
    return [(canvas.line(frame, 0.009), colour, 0.006), (canvas.line(hook, 0.004), np.float32([0.6] * 3), 0.003)]


def folded_clothes(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    colour = hue(rng, (0.05, 0.7), (0.15, 0.9))
    parts: Parts = []
    frame = _frame(rng, at, rng.uniform(0.09, 0.14), rng.uniform(0.12, 0.17))
    for scale in (1.0, 0.97, 0.94):
        parts.append((canvas.mask(frame(scale, scale)), colour * rng.uniform(0.85, 1.1), 0.012))
    return parts


NEARBY: tuple[Callable[[np.random.Generator, Canvas, Points], Parts], ...] = (
    *THINGS, book, laptop, paper, shoe, hanger, folded_clothes,
)  # fmt: skip


def surround(rng: np.random.Generator, canvas: Canvas, occupied: Field) -> list[Parts]:
    """Things all around what is occupied, near it and never on it."""
    taken = _grown(occupied, NEAR / canvas.pixel)
    placed: list[Parts] = []
    for _ in range(rng.integers(FEWEST, MOST + 1)):
        make = NEARBY[rng.integers(len(NEARBY))]
        for _ in range(8):  # a thing that finds no place is left out
            rows, columns = rng.uniform(0, 1, 2) * canvas.shape
            at = np.array(canvas.far_left) - np.array([rows, columns]) * canvas.pixel
            thing = make(rng, canvas, at)
            cover = np.max([part[0] for part in thing], axis=0)
            if cover.any() and not ((cover > 0) & taken).any():
                taken |= _grown(cover, NEAR / canvas.pixel)
                placed.append(thing)
                break
    return placed


def _grown(cover: Field, reach: float) -> np.ndarray:
    away = cv2.distanceTransform((cover <= 0).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(away < reach)


def _frame(rng: np.random.Generator, at: Points, half_x: float, half_y: float) -> Callable[[float, float], Points]:
    angle = rng.uniform(0, 2 * np.pi)
    u = np.array([np.cos(angle), np.sin(angle)])
    v = np.array([-u[1], u[0]])

    def corners(a: float, b: float) -> Points:
        sides = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        return np.array([at + s * a * half_x * u + t * b * half_y * v for s, t in sides])

    return corners
