"""What a picture of a garment's mesh needs: its outline as seen from above, and its normals."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array

OUTLINE_PIXEL = 0.001
"""Outlines are traced in pixels of this size on the table [m]."""


def outline(vertices: Array, triangles: NDArray[np.integer]) -> list[Array]:
    """Return the silhouette from above: outer contours [(k, 2), ...] in the table frame [m], the largest first."""
    low = vertices[:, :2].min(axis=0) - 5 * OUTLINE_PIXEL
    size = np.ceil((vertices[:, :2].max(axis=0) - low) / OUTLINE_PIXEL).astype(int) + 6
    mask = np.zeros((int(size[1]), int(size[0])), dtype=np.uint8)
    pixels = np.round((vertices[:, :2] - low) / OUTLINE_PIXEL).astype(np.int32)
    for triangle in pixels[triangles]:  # one fillPoly call for all would leave overlaps unfilled
        cv2.fillConvexPoly(mask, triangle, 255)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    smooth = [cv2.approxPolyDP(c, 1.0, True)[:, 0, :] for c in sorted(contours, key=cv2.contourArea, reverse=True)]
    return [c * OUTLINE_PIXEL + low for c in smooth if len(c) >= 3]


def vertex_normals(vertices: Array, triangles: NDArray[np.integer]) -> Array:
    """Return the unit normals (n, 3) at the vertices (n, 3), weighted by the areas of the triangles (m, 3)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normal = np.zeros_like(vertices)
    for axis in range(3):
        for k in range(3):
            normal[:, axis] += np.bincount(triangles[:, k], face[:, axis], len(vertices))
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
