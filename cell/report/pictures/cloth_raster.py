"""Rasters for drawn cloth: a z-buffer with smooth shading, and the mask of a shadow. Pixels only, no camera."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array
from foldcell.skills.compiled import cached

__all__ = ["Raster", "darken", "draw_cloth", "raster_cloth", "raster_shadow"]

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

Raster = tuple[tuple[slice, slice], NDArray[np.float32], NDArray[np.uint8]]
"""The part of the picture that the cloth covers (rows, columns), its brightness there (NaN: no cloth), and 1 where
the front of the cloth shows."""


def raster_cloth(
    pixels: Array,
    triangles: NDArray[np.integer],
    shade: Array,
    facing: Array,
    shape: tuple[int, int],
    sliver: int,
) -> Raster | None:
    """Raster triangles (m, 3). pixels: (n, 3) column, row [px] and depth; shade, facing: (n,) brightness, and
    positive where the front is seen; shape: of the picture. None: the cloth is outside the picture.

    sliver: a strip of cloth of about twice this width [px] or less is a sliver. If one side of the cloth shows
    only in a sliver beside the other side, it is drawn in the colour of the other side.
    """
    margin = 2 * sliver + 2
    low = np.maximum(np.floor(pixels[:, 1::-1].min(axis=0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(pixels[:, 1::-1].max(axis=0)).astype(int) + margin, shape)
    if np.any(high <= low):
        return None
    part = slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
    size = int(high[0] - low[0]), int(high[1] - low[1])
    depth = np.full(size, np.inf, np.float32)
    tone = np.full(size, np.nan, np.float32)
    front = np.zeros(size, np.uint8)
    local = np.ascontiguousarray(pixels - [low[1], low[0], 0.0])
    _rasterise(local, triangles.astype(np.int64), shade, facing, depth, tone, front)
    return part, tone, _without_slivers(front, np.isfinite(depth), sliver)


def raster_shadow(
    pixels: Array, triangles: NDArray[np.integer], shape: tuple[int, int], softness: float
) -> NDArray[np.float32]:
    """Return the shadow (shape) of triangles, 0 (none) to 1, with a soft edge. pixels: (n, 2) corners [px];
    softness: standard deviation of the blur [px]."""
    flat, even = np.column_stack([pixels[:, :2], np.zeros(len(pixels))]), np.ones(len(pixels))
    depth, tone, front = np.full(shape, np.inf, np.float32), np.empty(shape, np.float32), np.empty(shape, np.uint8)
    _rasterise(flat, triangles.astype(np.int64), even, even, depth, tone, front)
    soft = cv2.GaussianBlur(np.where(np.isfinite(depth), 255, 0).astype(np.uint8), (0, 0), softness)
    return np.asarray(soft, dtype=np.float32) / np.float32(255.0)


def _without_slivers(front: NDArray[np.uint8], cloth: NDArray[np.bool_], sliver: int) -> NDArray[np.uint8]:
    """Remove slivers from `front` (H, W), which is 1 where the front of the cloth shows and 0 elsewhere. Slivers
    occur along an open hem, because the coarse edges of two mesh layers cross there: without this step the inside
    of one layer would look like a row of teeth. cloth: (H, W), true where cloth is visible."""
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * sliver + 1, 2 * sliver + 1))
    for side in (1, 0):
        mask = (cloth & (front == side)).astype(np.uint8)
        if not mask.any():
            continue
        thin = (mask > 0) & (cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel) == 0)
        other = cv2.dilate((cloth & (front != side)).astype(np.uint8), kernel) > 0
        front = np.where(thin & other, 1 - side, front).astype(np.uint8)
    return front


@cached()
def _rasterise(p, triangles, shade, facing, depth, tone, front):  # type: ignore[no-untyped-def]
    """Fill triangles with a z-buffer. p: (n, 3) pixel and depth; shade, facing: (n,) at the vertices. depth, tone,
    front: (H, W) results: depth, brightness, and 1 where the front of the cloth shows."""
    height, width = depth.shape
    for m in range(triangles.shape[0]):
        i, j, k = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        x0, y0, x1, y1, x2, y2 = p[i, 0], p[i, 1], p[j, 0], p[j, 1], p[k, 0], p[k, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        left, right = max(0, int(min(x0, x1, x2))), min(width - 1, int(max(x0, x1, x2)) + 1)
        top, bottom = max(0, int(min(y0, y1, y2))), min(height - 1, int(max(y0, y1, y2)) + 1)
        # a triangle shows one side only, even if its vertices face different ways
        side = facing[i] + facing[j] + facing[k] > 0.0
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                b = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
                c = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
                a = 1.0 - b - c
                if a < -1e-6 or b < -1e-6 or c < -1e-6:
                    continue
                z = a * p[i, 2] + b * p[j, 2] + c * p[k, 2]
                if z < depth[row, column]:
                    depth[row, column] = z
                    tone[row, column] = a * shade[i] + b * shade[j] + c * shade[k]
                    front[row, column] = side


def darken(canvas: Picture, shadow: NDArray[Any], strength: float) -> None:
    """Darken a picture (H, W, 3) in place by `strength` (0..1) where the shadow (H, W) is 1."""
    dark = shadow > 0.0
    left = 1.0 - strength * shadow[dark, None].astype(float)
    canvas[dark] = (canvas[dark] * left + 0.5).astype(np.uint8)


def draw_cloth(canvas: Picture, tone: NDArray[np.float32], front: NDArray[np.uint8], colours: Array) -> None:
    """Paint rastered cloth onto a part (H, W, 3) of a picture, in place. colours: (2, 3) of its back and front."""
    cloth = ~np.isnan(tone)
    lit = tone[cloth, None].astype(float) * colours[front[cloth]]
    canvas[cloth] = np.minimum(lit, 255.0).astype(np.uint8)
