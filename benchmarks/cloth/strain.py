"""How much longer or shorter than at rest edges are, away from pinches and creases.

A crease is where cloth turns, over however many hinges: one that is round, or on a fine mesh, has no sharp hinge.
An edge is beside a crease if within reach of one of its ends, at rest and in a straight line (also across a
notch), there are the middles of two triangles of one layer that are turned against each other by more than TURN.
Of a sharp crease that leaves out all within reach; of an arc with a radius of up to the reach over TURN the arc,
and beside it what is within reach of as much of it as turns by TURN; with up to twice that radius only its middle;
of a rounder one nothing.
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
"""Cloth that turns by more within reach is beside a crease: it no longer lies, and does not stand yet."""
BESIDE = 0.040
"""Cloth so near a pinch or a crease [m], or two edges, is left out of the strain."""
NO_AREA = 1e-30
"""[m2] instead of 0."""
MOST_STRAIN = 0.05
"""Edges strained by more are counted."""


@dataclass(frozen=True, eq=False)
class EdgeStrains:
    """Of edges away from pinches and fold lines: strain (k,), of longer ones positive; turn (k,) of the cloth
    within reach of each [rad]."""

    strain: Array
    turn: Array

    def away(self, turn: float = TURN) -> Array:
        """Strains of the edges about which the cloth turns by no more [rad]."""
        return np.asarray(self.strain[self.turn <= turn])


def reach(mesh: ClothMesh) -> float:
    """How near a pinch or a crease [m] the strain is not taken."""
    return max(BESIDE, 2.0 * float(np.median(mesh.edge_length)))


def on_the_line(x: Array, paths: Paths, distance: float) -> NDArray[np.bool_]:
    """(n,) vertices, of cloth at x (n, 3), nearer than `distance` [m] to the fold's line: half way between where
    the hands take the cloth and where they lay it."""
    start, end = (np.mean([path.position[k, :2] for path in paths.values()], axis=0) for k in (0, -1))
    across = (end - start) / np.linalg.norm(end - start)
    return np.asarray(np.abs((x[:, :2] - 0.5 * (start + end)) @ across) < distance)


def edge_strains(mesh: ClothMesh, x: Array, pinched: Array, lined: NDArray[np.bool_]) -> EdgeStrains:
    """Of cloth at x (n, 3): edges that are not within reach of the points `pinched` (k, 2, material coordinates)
    and have no end among the vertices `lined` (n,)."""
    left_out = lined | _beside(mesh, pinched)
    edges = mesh.edges[~left_out[mesh.edges].any(axis=1)]
    now, rest = (np.linalg.norm(at[edges[:, 0]] - at[edges[:, 1]], axis=1) for at in (x, mesh.rest))
    return EdgeStrains(np.asarray(now / rest - 1.0), turns(mesh, x)[edges].max(axis=1, initial=0.0))


def turns(mesh: ClothMesh, x: Array) -> Array:
    """(n,) the largest angle [rad] between two triangles of one layer whose middles, at rest, are within reach of
    each vertex; the layer need not be its own: layers are creased together."""
    p = x[mesh.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), NO_AREA)  # what has none is turned
    middle = mesh.rest[mesh.triangles].mean(axis=1)
    places, place = np.unique(mesh.rest, axis=0, return_inverse=True)
    least = np.ones(len(places))  # cosine
    for layer in np.unique(mesh.triangle_layer):
        own = np.flatnonzero(mesh.triangle_layer == layer)
        for k, near in enumerate(cKDTree(middle[own]).query_ball_point(places, reach(mesh))):
            directions = normal[own[near]]
            least[k] = min(least[k], (directions @ directions.T).min(initial=1.0))
    return np.asarray(np.arccos(np.clip(least, -1.0, 1.0))[place.reshape(-1)])


def _beside(mesh: ClothMesh, points: Array) -> NDArray[np.bool_]:
    """(n,) vertices within reach of `points` (k, 2, material coordinates), of any layer."""
    if len(points) == 0:
        return np.zeros(len(mesh.rest), dtype=bool)
    return np.asarray(cKDTree(points).query(mesh.rest)[0] <= reach(mesh))
