"""Random textures of the table and the fabrics."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.skills.vocabulary import Array

Texture = NDArray[np.uint8]

SIZE = 512
TABLE_HSV = {"bare_table": (16, 85, 168), "laminate": (20, 25, 190), "felt": (62, 90, 95)}
"""OpenCV hue (0..179), saturation and value of table surfaces. Other surfaces look like the bare table."""
FABRIC_HUES = (0, 6, 58, 88, 105, 115, 125, 150, 170)
"""OpenCV hues (0..179) that differ clearly from the table's."""


def table_texture(rng: np.random.Generator, surface: str) -> Texture:
    """Draw a random texture (SIZE, SIZE, 3) RGB: the surface's colour with a grain along x."""
    hue, saturation, value = TABLE_HSV.get(surface, TABLE_HSV["bare_table"])
    streaks = _noise(rng, (4.0, 60.0)) * 12.0 + _noise(rng, (30.0, 60.0)) * 8.0 + _noise(rng, (0.8, 2.0)) * 4.0
    return _coloured(
        hue + rng.uniform(-2, 2), saturation + rng.uniform(-10, 10), value + rng.uniform(-8, 8) + streaks
    )


def contrasting_colour(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw hue, saturation and value (OpenCV) of a fabric whose hue is far from the table's."""
    hue = rng.choice(FABRIC_HUES) + rng.uniform(-3, 3)
    return hue, rng.uniform(110, 190), rng.uniform(95, 200)


def fabric_texture(rng: np.random.Generator, colour: tuple[float, float, float]) -> Texture:
    """Draw a random texture (SIZE, SIZE, 3) RGB: a plain or striped weave with hems. colour: hue, saturation and
    value (OpenCV)."""
    hue, saturation, value = colour
    weave = _noise(rng, (0.7, 0.7)) * 5.0 + _noise(rng, (6.0, 6.0)) * 4.0
    bright = np.full((SIZE, SIZE), value) + weave
    if rng.random() < 0.5:
        bright += _stripes(rng)
    hem = 10
    bright[[*range(hem), *range(SIZE - hem, SIZE)], :] -= 14.0
    bright[:, [*range(hem), *range(SIZE - hem, SIZE)]] -= 14.0
    return _coloured(hue, saturation, bright)


def garment_uv(rest: Array, layer: NDArray[np.int32]) -> Array:
    """Compute texture coordinates (n, 2) of mesh vertices from their material coordinates (n, 2) and layers (n,).
    The texture is mirrored on the upper layer, so that front and back do not match by accident."""
    low, span = rest.min(axis=0), np.ptp(rest, axis=0)
    uv = (rest - low) / span
    uv[layer > 0, 0] = 1.0 - uv[layer > 0, 0]
    return np.clip(uv, 0.002, 0.998)


def _stripes(rng: np.random.Generator) -> Array:
    """Draw the brightness (SIZE, SIZE) of two bands of stripes across the fabric."""
    u = np.linspace(0.0, 1.0, SIZE)
    band = np.zeros(SIZE)
    for centre in rng.uniform(0.08, 0.2, 1).tolist() + rng.uniform(0.8, 0.92, 1).tolist():
        band += 40.0 * np.sign(np.sin(2 * np.pi * (u - centre) / 0.02)) * (np.abs(u - centre) < 0.04)
    return np.tile(band, (SIZE, 1)) if rng.random() < 0.5 else np.tile(band[:, None], (1, SIZE))


def _noise(rng: np.random.Generator, sigma: tuple[float, float]) -> Array:
    """Draw smooth noise (SIZE, SIZE) of standard deviation 1. sigma: correlation length along x and y [px]."""
    field = cv2.GaussianBlur(rng.standard_normal((SIZE, SIZE)), (0, 0), sigmaX=sigma[0], sigmaY=sigma[1])
    return np.asarray(field / field.std(), dtype=np.float64)


def _coloured(hue: float, saturation: float, value: Array) -> Texture:
    hsv = np.empty((SIZE, SIZE, 3), np.uint8)
    hsv[..., 0] = int(hue) % 180
    hsv[..., 1] = np.clip(saturation, 0, 255)
    hsv[..., 2] = np.clip(value, 0, 255)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), dtype=np.uint8)
