"""The objective of the paper (Li et al., see README.md): path length plus a weighted dissimilarity of the folded
shape to its target."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foldcell.skills.vocabulary import Array

ALPHA = 1e3
"""Weight of the dissimilarity against the path's length, both in metres (the paper's alpha)."""


def dissimilarity(target: Array, simulated: Array, triangles: NDArray[np.int32], area: Array) -> float:
    """Return D [m]: the mean distance between corresponding barycentres of triangles, weighted by area, over all
    sheets of the mesh.

    target, simulated: (n, 3) vertices [m]; triangles: (m, 3). area: (m,) rest areas of the triangles [m2]. (The
    paper takes their areas in the target, in which triangles across a fold line have shrunk.)
    """
    apart = (target[triangles] - simulated[triangles]).mean(axis=1)
    return float(np.linalg.norm(apart, axis=1) @ area / area.sum())


def cost(lengths: Array, d: float) -> float:
    """Return C(x) = l + ALPHA D [m], where l is the sum of the lengths of the arcs."""
    return float(np.sum(lengths) + ALPHA * d)
