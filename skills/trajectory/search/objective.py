"""The objective of the paper (Li et al., see README.md): path length plus a weighted dissimilarity of the folded
shape to its target."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skills.vocabulary import Array

__all__ = ["ALPHA", "cost", "dissimilarity", "triangle_areas"]

ALPHA = 1e3
"""Weight of the dissimilarity against the path's length, both in metres (the paper's alpha)."""


def triangle_areas(vertices: Array, triangles: NDArray[np.int32]) -> Array:
    """Return the areas [m2], (m,), of triangles (m, 3) over vertices (n, 2) or (n, 3)."""
    a, b, c = np.moveaxis(_in_space(vertices)[triangles], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def dissimilarity(
    target: Array, simulated: Array, triangles: NDArray[np.int32], area: Array | None = None
) -> float:
    """Return D [m]: the mean distance between corresponding barycentres of triangles, weighted by area, over all
    sheets of the mesh.

    target, simulated: (n, 3) vertices [m]; triangles: (m, 3). area: (m,) areas of the triangles [m2]; default:
    their areas in the target, as in the paper. Pass the rest areas if triangles lie across a fold line, since
    folding shrinks these triangles.
    """
    weights = triangle_areas(target, triangles) if area is None else area
    apart = (target[triangles] - simulated[triangles]).mean(axis=1)
    return float(np.linalg.norm(apart, axis=1) @ weights / weights.sum())


def cost(lengths: Array, d: float, alpha: float = ALPHA) -> float:
    """Return C(x) = l + alpha D [m], where l is the sum of the lengths of the arcs."""
    return float(np.sum(lengths) + alpha * d)


def _in_space(vertices: Array) -> Array:
    return vertices if vertices.shape[1] == 3 else np.column_stack([vertices, np.zeros(len(vertices))])
