"""Strain of the edges away from pinches and creases.

A crease is a place where the cloth turns, over any number of hinges: a round crease, or one on a fine mesh, has no
sharp hinge. An edge is beside a crease if two triangles of one layer are turned against each other by more than
TURN and their middles lie within reach of one of the edge's ends. The reach is measured at rest and in a straight
line, also across a notch.

At a sharp crease, this excludes all edges within reach. At an arc with a radius of up to reach / TURN, it excludes
the arc, and beside it the edges within reach of a part that turns by TURN. At an arc with up to twice that radius,
it excludes only the middle of the arc. At a rounder one, it excludes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.cloth.scenes import Paths
from robots.ports import Array
from skills.cloth.mesh import ClothMesh

__all__ = ["MOST_STRAIN", "TURN", "EdgeStrains", "edge_strains", "on_the_line", "reach", "turns"]

TURN = np.deg2rad(45.0)
"""Cloth that turns by more than this angle within reach is beside a crease: it is between lying and standing."""
BESIDE = 0.040
"""Distance from a pinch or a crease within which strain is not measured [m]; at least two edge lengths."""
NO_AREA = 1e-30
"""Minimum of twice a triangle's area, to avoid a division by zero [m2]."""
MOST_STRAIN = 0.05
"""Edges with more strain than this are counted."""


@dataclass(frozen=True, eq=False)
class EdgeStrains:
    """Edges away from pinches and fold lines. strain: (k,) positive for elongated edges. turn: (k,) angle by which
    the cloth turns within reach of each edge [rad]."""

    strain: Array
    turn: Array

    def away(self, turn: float = TURN) -> Array:
        """Strains of the edges about which the cloth turns by at most `turn` [rad]."""
        return np.asarray(self.strain[self.turn <= turn])


def reach(mesh: ClothMesh) -> float:
    """Distance from a pinch or a crease within which strain is not measured [m]."""
    return max(BESIDE, 2.0 * float(np.median(mesh.edge_length)))


def on_the_line(x: Array, paths: Paths, distance: float) -> NDArray[np.bool_]:
    """(n,) whether a vertex of cloth at x (n, 3) is nearer than `distance` [m] to the fold line, which is midway
    between the hands' starts and ends."""
    start, end = (np.mean([path.position[k, :2] for path in paths.values()], axis=0) for k in (0, -1))
    across = (end - start) / np.linalg.norm(end - start)
    return np.asarray(np.abs((x[:, :2] - 0.5 * (start + end)) @ across) < distance)


def edge_strains(mesh: ClothMesh, x: Array, pinched: Array, lined: NDArray[np.bool_]) -> EdgeStrains:
    """Strains of the edges of cloth at x (n, 3) that are away from pinches and fold lines.

    pinched: (k, 2) points in material coordinates; edges within their reach are left out. lined: (n,) vertices
    near fold lines; edges with an end among them are left out.
    """
    left_out = lined | _beside(mesh, pinched)
    edges = mesh.edges[~left_out[mesh.edges].any(axis=1)]
    now, rest = (np.linalg.norm(at[edges[:, 0]] - at[edges[:, 1]], axis=1) for at in (x, mesh.rest))
    return EdgeStrains(np.asarray(now / rest - 1.0), turns(mesh, x)[edges].max(axis=1, initial=0.0))


def turns(mesh: ClothMesh, x: Array) -> Array:
    """(n,) largest angle [rad] between two triangles of one layer whose middles, at rest, are within reach of a
    vertex.

    The vertex can belong to another layer, because layers are creased together.
    """
    p = x[mesh.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    # A triangle without area has no normal and counts as turned.
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), NO_AREA)
    middle = mesh.rest[mesh.triangles].mean(axis=1)
    places, place = np.unique(mesh.rest, axis=0, return_inverse=True)
    least = np.ones(len(places))  # smallest cosine of an angle between normals
    for layer in np.unique(mesh.triangle_layer):
        own = np.flatnonzero(mesh.triangle_layer == layer)
        for k, near in enumerate(cKDTree(middle[own]).query_ball_point(places, reach(mesh))):
            directions = normal[own[near]]
            least[k] = min(least[k], (directions @ directions.T).min(initial=1.0))
    return np.asarray(np.arccos(np.clip(least, -1.0, 1.0))[place.reshape(-1)])


def _beside(mesh: ClothMesh, points: Array) -> NDArray[np.bool_]:
    """(n,) whether a vertex, of any layer, is within reach of `points` (k, 2, material coordinates)."""
    if len(points) == 0:
        return np.zeros(len(mesh.rest), dtype=bool)
    return np.asarray(cKDTree(points).query(mesh.rest)[0] <= reach(mesh))
