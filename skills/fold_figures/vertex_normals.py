"""Normals of a triangle mesh, for pictures of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foldcell.robots.ports import Array

__all__ = ["vertex_normals"]


def vertex_normals(vertices: Array, triangles: NDArray[np.integer]) -> Array:
    """Return the unit normals (n, 3) at the vertices (n, 3), weighted by the areas of the triangles (m, 3)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normal = np.zeros_like(vertices)
    for axis in range(3):
        for k in range(3):
            normal[:, axis] += np.bincount(triangles[:, k], face[:, axis], len(vertices))
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
