"""Drawn cloth: its brightness and which of its sides shows, and the mask of a shadow."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.cell.report.pictures.mesh_raster import Canvas, Lens, Mesh, draw_mesh
from foldcell.robots.ports import Array
from foldcell.skills.fold_figures.drawn_mesh import vertex_normals

Picture = NDArray[np.uint8]
SIDES = np.array([[[255, 0, 0], [255, 255, 0]]], np.uint8)
"""Texture of the back and of the front: the first channel becomes the brightness, the second tells the sides
apart."""


def raster_cloth(
    vertices: Array,
    triangles: NDArray[np.integer],
    pose: Array,
    lens: Lens,
    light: Array,
    shape: tuple[int, int],
    sliver: int,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Raster cloth (n, 3), (m, 3). Returns its brightness (H, W), NaN where no cloth is, and 1 where its front
    shows. pose: (4, 4) of the cloth's frame in that of the camera; light: (3,) unit vector to the light, in the
    camera's frame; shape: of the picture.

    sliver: a strip of cloth of about twice this width [px] or less is a sliver. If one side of the cloth shows
    only in a sliver beside the other side, it is drawn in the colour of the other side.
    """
    canvas = _drawn(vertices, triangles, pose, lens, light, shape)
    cloth = canvas.nearest > 0.0
    tone = np.where(cloth, canvas.rgb[..., 0] / np.float32(255.0), np.float32(np.nan))
    return tone, _without_slivers((canvas.rgb[..., 1] > 0).astype(np.uint8), cloth, sliver)


def raster_shadow(
    vertices: Array,
    triangles: NDArray[np.integer],
    pose: Array,
    lens: Lens,
    shape: tuple[int, int],
    softness: float,
) -> NDArray[np.float32]:
    """Return the shadow (H, W) of cloth on a plane, 0 (none) to 1, with a soft edge. vertices: (n, 3) of the
    shadow; softness: standard deviation of the blur [px]."""
    canvas = _drawn(vertices, triangles, pose, lens, np.zeros(3), shape)
    soft = cv2.GaussianBlur(np.where(canvas.nearest > 0.0, 255, 0).astype(np.uint8), (0, 0), softness)
    return np.asarray(soft, dtype=np.float32) / np.float32(255.0)


def _drawn(
    vertices: Array, triangles: NDArray[np.integer], pose: Array, lens: Lens, light: Array, shape: tuple[int, int]
) -> Canvas:
    """Draw the sides of cloth. A triangle shows one side only, even if its vertices face different ways."""
    normals, eye = vertex_normals(vertices, triangles), -pose[:3, :3].T @ pose[:3, 3]
    facing = np.einsum("ij,ij->i", normals, eye - vertices)
    front = np.repeat(facing[triangles].sum(axis=1) > 0.0, 3)
    corners, count = triangles.ravel(), triangles.size
    each = np.arange(count, dtype=np.int32).reshape(-1, 3)
    texels = np.column_stack([front + 0.5, np.full(count, 0.5)])
    mesh = Mesh(vertices[corners], normals[corners], np.zeros(count, np.int32), each, texels, SIDES)
    canvas = Canvas(np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32))
    draw_mesh(canvas, mesh, pose[None], lens, light)
    return canvas


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
