"""How much longer or shorter than at rest edges are, away from pinches and creases."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.cloth.scenes import Paths
from robots.ports import Array
from skills.cloth.mesh import ClothMesh

__all__ = ["MOST_STRAIN", "on_the_line", "reach", "strains"]

SHARP = np.deg2rad(60.0)
"""Hinges bent by more are a crease."""
BESIDE = 0.040
"""Cloth so near a pinch or a crease [m], or two edges, is left out of the strain."""
MOST_STRAIN = 0.05
"""Edges strained by more are counted."""


def reach(mesh: ClothMesh) -> float:
    """How near a pinch or a crease [m] the strain is not taken."""
    return max(BESIDE, 2.0 * float(np.median(mesh.edge_length)))


def on_the_line(x: Array, paths: Paths, distance: float) -> NDArray[np.bool_]:
    """(n,) vertices, of cloth at x (n, 3), nearer than `distance` [m] to the fold's line: half way between where
    the hands take the cloth and where they lay it."""
    start, end = (np.mean([path.position[k, :2] for path in paths.values()], axis=0) for k in (0, -1))
    across = (end - start) / np.linalg.norm(end - start)
    return np.asarray(np.abs((x[:, :2] - 0.5 * (start + end)) @ across) < distance)


def strains(mesh: ClothMesh, x: Array, pinched: Array, creased: NDArray[np.bool_]) -> Array:
    """The strain of each edge, (k,), away from the points `pinched` (k, 2, material coordinates), from hinges that
    are bent sharply, and from `creased` vertices (n,)."""
    left_out = creased | _beside(mesh, np.vstack([mesh.rest[np.unique(_sharp(mesh, x))], pinched]))
    edges = mesh.edges[~left_out[mesh.edges].any(axis=1)]
    now, rest = (np.linalg.norm(at[edges[:, 0]] - at[edges[:, 1]], axis=1) for at in (x, mesh.rest))
    return np.asarray(now / rest - 1.0)


def _beside(mesh: ClothMesh, points: Array) -> NDArray[np.bool_]:
    """(n,) vertices within reach of `points` (k, 2, material coordinates), of any layer."""
    if len(points) == 0:
        return np.zeros(len(mesh.rest), dtype=bool)
    return np.asarray(cKDTree(points).query(mesh.rest)[0] <= reach(mesh))


def _sharp(mesh: ClothMesh, x: Array) -> Array:
    a, b, p, q = (x[mesh.hinges[:, k]] for k in range(4))
    one, other = np.cross(b - a, p - a), np.cross(q - a, b - a)
    cos = (one * other).sum(axis=1) / np.linalg.norm(one, axis=1) / np.linalg.norm(other, axis=1)
    return mesh.hinges[cos < np.cos(SHARP)]
