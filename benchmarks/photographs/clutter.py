"""Things that lie about: at the border of the picture, partly outside, never on the garment."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas, footprint
from benchmarks.photographs.cloth import over
from benchmarks.photographs.lens import Camera
from benchmarks.photographs.light import cast_shadow
from benchmarks.photographs.noise import Field
from benchmarks.photographs.outline import Points

GAP = 0.04
"""Smallest distance [m] of a thing from the garment."""

Parts = list[tuple[Field, Field, float]]
"""Coverage, colour and height [m] of each part of a thing, from below upwards."""


def cup(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    radius = rng.uniform(0.035, 0.048)
    colour = np.float32(rng.uniform(0.2, 0.95, 3))
    handle = at + radius * 1.25 * _direction(rng)
    return [
        (canvas.mask(_disc(handle, radius * 0.3)), colour * 0.9, 0.03),
        (canvas.mask(_disc(at, radius)), colour, 0.05),
        (canvas.mask(_disc(at, radius * 0.88)), np.float32([0.08, 0.13, 0.22]), 0.0),
    ]


def pen(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    along = _direction(rng) * rng.uniform(0.065, 0.08)
    colour = np.float32(rng.uniform(0.05, 0.8, 3))
    return [
        (canvas.line(np.array([at - along, at + along]), 0.009), colour, 0.006),
        (canvas.line(np.array([at + along * 0.85, at + along]), 0.006), np.float32([0.7, 0.7, 0.7]), 0.0),
    ]


def cable(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    steps = np.cumsum(rng.normal(0, 0.5, 60))
    heading = rng.uniform(0, 2 * np.pi) + steps * 0.2
    line = at + 0.006 * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    return [(canvas.line(line, 0.005), np.float32(rng.choice([0.08, 0.85]) * np.ones(3)), 0.004)]


def box(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    """A telephone, a notebook, a packet."""
    half = np.array([rng.uniform(0.035, 0.08), rng.uniform(0.05, 0.1)])
    colour = np.float32(rng.uniform(0.05, 0.9, 3))
    u = _direction(rng)
    v = np.array([-u[1], u[0]])
    sides = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    outer, inner = (np.array([at + k * (a * half[0] * u + b * half[1] * v) for a, b in sides]) for k in (1.0, 0.9))
    return [(canvas.mask(outer), colour, 0.012), (canvas.mask(inner), colour * rng.uniform(0.7, 1.1), 0.0)]


def tape(rng: np.random.Generator, canvas: Canvas, at: Points) -> Parts:
    """A roll of tape: a ring."""
    ring = np.vstack([_disc(at, 0.045), _disc(at, 0.045)[:1]])
    return [(canvas.line(ring, 0.014), np.float32(rng.uniform(0.3, 0.8, 3)), 0.02)]


Making = Callable[[np.random.Generator, Canvas, Points], Parts]
THINGS: tuple[Making, ...] = (cup, pen, cable, box, tape)


def scatter(
    rng: np.random.Generator, canvas: Canvas, camera: Camera, garment: Field, things: tuple[Making, ...] = THINGS
) -> list[Parts]:
    """Up to four things near the border of the picture."""
    border = footprint(camera)
    reach = round(GAP / canvas.pixel)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    forbidden = cv2.dilate((garment > 0).astype(np.uint8), kernel) > 0
    placed: list[Parts] = []
    for _ in range(int(rng.choice(5, p=[0.3, 0.25, 0.2, 0.15, 0.1]))):
        for _ in range(6):  # a thing that finds no place is left out
            at = border[rng.integers(len(border))] + rng.normal(0, 0.05, 2)
            thing = things[rng.integers(len(things))](rng, canvas, at)
            cover = np.max([part[0] for part in thing], axis=0) > 0
            if cover.any() and not (cover & forbidden).any():
                forbidden |= cv2.dilate(cover.astype(np.uint8), kernel) > 0
                placed.append(thing)
                break
    return placed


def lay(picture: Field, thing: Parts, canvas: Canvas, light: Points) -> Field:
    """The picture with the thing and its shadow."""
    for cover, _, height in thing:
        if height > 0:
            picture = picture * cast_shadow(cover, canvas, light, height, 0.45)[..., None]
    for cover, colour, _ in thing:
        picture = over(picture, cover, colour)
    return picture


def _direction(rng: np.random.Generator) -> Points:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _disc(at: Points, radius: float) -> Points:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    return np.asarray(at + radius * np.column_stack([np.cos(turn), np.sin(turn)]))
