"""Computes the strain of the edges that are away from pinches and creases.

skills/cloth/strain.py defines what counts as beside a crease.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.cloth.scenes import Paths
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.strain import MOST_STRAIN, TURN, reach, turns

__all__ = ["MOST_STRAIN", "EdgeStrains", "edge_strains", "on_the_line"]


@dataclass(frozen=True, eq=False)
class EdgeStrains:
    """Strains of k edges that are away from pinches and fold lines. strain: (k,) positive for elongated edges.
    turn: (k,) largest angle between two triangles of one layer within reach of the edge [rad]."""

    strain: Array
    turn: Array

    def away(self, turn: float = TURN) -> Array:
        """Return the strains of the edges near which the cloth turns by at most `turn` [rad]."""
        return np.asarray(self.strain[self.turn <= turn])


def on_the_line(x: Array, paths: Paths, distance: float) -> NDArray[np.bool_]:
    """Return (n,) whether each vertex of cloth at x (n, 3) is nearer than `distance` [m] to the fold line. The
    line is midway between the starts and the ends of the hands' paths."""
    start, end = (np.mean([path.position[k, :2] for path in paths.values()], axis=0) for k in (0, -1))
    across = (end - start) / np.linalg.norm(end - start)
    return np.asarray(np.abs((x[:, :2] - 0.5 * (start + end)) @ across) < distance)


def edge_strains(mesh: ClothMesh, x: Array, pinched: Array, lined: NDArray[np.bool_]) -> EdgeStrains:
    """Compute the strains of the edges of cloth at x (n, 3) that are away from pinches and fold lines.

    pinched: (k, 2) pinched points in material coordinates; edges within reach of them are left out. lined: (n,)
    whether a vertex is near a fold line; edges with such an end are left out.
    """
    left_out = lined | _beside(mesh, pinched)
    edges = mesh.edges[~left_out[mesh.edges].any(axis=1)]
    now, rest = (np.linalg.norm(at[edges[:, 0]] - at[edges[:, 1]], axis=1) for at in (x, mesh.rest))
    return EdgeStrains(np.asarray(now / rest - 1.0), turns(mesh, x)[edges].max(axis=1, initial=0.0))


def _beside(mesh: ClothMesh, points: Array) -> NDArray[np.bool_]:
    """Return (n,) whether each vertex, of any layer, is within reach of one of `points` (k, 2), given in material
    coordinates."""
    if len(points) == 0:
        return np.zeros(len(mesh.rest), dtype=bool)
    return np.asarray(cKDTree(points).query(mesh.rest)[0] <= reach(mesh))
