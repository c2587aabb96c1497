"""The garment's cloth and sewing: colours in linear light, and heights [m] on the layer."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.photographs.canvas import Canvas
from benchmarks.photographs.cloth import lab, over
from benchmarks.photographs.noise import Field, smooth
from benchmarks.photographs.phone.grounds import linear
from benchmarks.photographs.real.dress import hems, printed, sewing, zone
from benchmarks.photographs.real.outlines import Flat

PALETTE = (
    0xf4f3ef, 0x17171a, 0x1d2740, 0x8c8f94, 0xb9bcc0, 0xb3202c, 0x6d1626, 0xe7d9bd, 0xc9a66b,
    0x5b4632, 0x2f4a36, 0x6f7f4f, 0x9cc3d9, 0x3c6ea8, 0x2a4f9e, 0x5a4a86, 0xb58fc0, 0xe9a3b4,
    0xd94f7a, 0xf0c53a, 0xe8812e, 0x4fa59a, 0xd7e3d0, 0x3a3f45, 0xf7e9e4, 0x806a5c,
)  # fmt: skip
"""Colours (red, green, blue) in which shops sell clothes."""
SHIRTS = ("t_shirt", "long_sleeve_shirt")
CONTRAST = 14.0
"""Smallest distance (CIELAB) of the main colour from the ground's: below it nobody would lay the garment there."""


def dye(rng: np.random.Generator, ground: Field | None = None, black_or_white: float = 0.25) -> Field:
    """A colour of the palette, some a little off; with `CONTRAST` to the ground's colour as a screen shows it."""
    while True:
        i = rng.integers(2) if rng.random() < black_or_white else rng.integers(len(PALETTE))
        exact = np.float32([PALETTE[i] >> shift & 255 for shift in (0, 8, 16)]) / 255
        colour = np.clip(exact + rng.normal(0, 0.02, 3), 0.04, 0.96).astype(np.float32)
        if ground is None or np.linalg.norm(lab(colour) - lab(ground)) > CONTRAST:
            return np.asarray(colour)


def dressed(
    rng: np.random.Generator, canvas: Canvas, lying: Flat, mask: Field, ground: Field, turn: float
) -> tuple[list[str], Field, Field]:
    """What was chosen, the colours and the heights of the sewing. ground: its colour near the garment."""
    up, left = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    middle = (lying.outline.min(axis=0) + lying.outline.max(axis=0)) / 2
    main, second = dye(rng, ground), dye(rng, ground, 0.5)
    v, u = np.mgrid[: canvas.shape[0], : canvas.shape[1]].astype(np.float32)
    x, y = canvas.far_left[0] - v * canvas.pixel - middle[0], canvas.far_left[1] - u * canvas.pixel - middle[1]
    sway = 0.003 * smooth(rng, canvas.shape, (0.12 / canvas.pixel, 0.12 / canvas.pixel))
    along, beside = (np.float32(x * way[0] + y * way[1] + sway) for way in (up, left))
    word = str(rng.choice(["plain", "plain", "stripes across", "stripes along", "checks", "motifs", "melange"]))
    share, period = np.zeros(canvas.shape, np.float32), rng.uniform(0.008, 0.06)
    if word in ("stripes across", "checks"):
        share += (np.mod(along, period) < rng.uniform(0.2, 0.5) * period).astype(np.float32)
    if word in ("stripes along", "checks"):
        share += (np.mod(beside, period) < rng.uniform(0.2, 0.5) * period).astype(np.float32)
    if word == "motifs":
        grain = (period / 2 / canvas.pixel, period / 2 / canvas.pixel)
        share = (smooth(rng, canvas.shape, grain) > 0.9).astype(np.float32)
    share = cv2.GaussianBlur(share, (0, 0), 0.7) * (0.5 if word == "checks" else 1.0)
    if word == "melange":
        share = np.clip(0.18 * smooth(rng, canvas.shape, (1.3, 5)) + 0.1, 0, 0.6)
    colours = linear(main) + share[..., None] * (linear(second) - linear(main))
    words = [word]
    if lying.category in SHIRTS and rng.random() < 0.3:
        cut, cover = zone(rng, canvas, lying, mask, -turn)
        words, colours = [*words, cut], over(colours, cover, linear(dye(rng, ground)))
    if lying.category in (*SHIRTS, "vest") and rng.random() < 0.4:
        cut, shown = printed(rng, canvas, lying, colours ** (1 / 2.2), middle, -turn)
        words, colours = [*words, cut], linear(shown)
    height = _texture(rng, canvas, lying.category, along, beside)
    colours = colours * (1 + 70 * np.clip(height, -0.0015, 0.0015))[..., None]
    colours, sewn = _sewn(rng, canvas, lying, np.asarray(colours, np.float32), linear(main))
    return words, colours, height + sewn


def _texture(rng: np.random.Generator, canvas: Canvas, category: str, along: Field, beside: Field) -> Field:
    """Heights of loops, ribs or threads. A thread that is finer than two pixels is only noise."""
    fine = smooth(rng, canvas.shape, (1.2, 1.2))
    if category == "towel":
        return np.asarray(0.00022 * fine + 0.0002 * smooth(rng, canvas.shape, (3, 3)), np.float32)
    pitch = rng.choice([0.0028, 0.004, 0.007], p=[0.6, 0.3, 0.1])
    ribs = np.sin(2 * np.pi * (beside + (0.6 * along if category == "pants" else 0)) / pitch)
    return np.asarray(0.00007 * fine + rng.uniform(0.00001, 0.00008) * ribs, np.float32)


def _sewn(
    rng: np.random.Generator, canvas: Canvas, lying: Flat, colours: Field, main: Field
) -> tuple[Field, Field]:
    """Hems, seams, neck, collar, buttons, pockets. What is sewn on stands out; a hem has two layers."""
    middle = lying.outline.mean(axis=0)
    drawn = sewing(rng, canvas, lying, colours, main, middle)
    height = 0.0007 * np.clip(20 * np.abs(drawn - colours).max(axis=2), 0, 1)
    for first, last, inset in hems(lying.category):
        height = height + 0.0006 * canvas.line(lying.arc(first, last), 2 * (inset or 0.02))
    return drawn, cv2.GaussianBlur(np.asarray(height, np.float32), (0, 0), 1.0)
