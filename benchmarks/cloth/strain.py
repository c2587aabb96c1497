"""Computes the strain of the edges that are away from pinches and creases.

A crease is a place where the cloth turns, over any number of mesh edges: a round crease, or one on a fine mesh,
has no single edge with a sharp bend. An edge is beside a crease if two triangles of one layer are turned against
each other by more than TURN and their middles lie within a distance, the reach, of one of the edge's ends. The
distance is measured on the undeformed mesh and in a straight line, also across a notch.

This has the following effects:

- Sharp crease: all edges within reach are excluded.
- Round bend with a radius of at most reach / TURN: the whole bend is excluded, and also the edges beside it that
  are within reach of a part that turns by TURN.
- Round bend with up to twice that radius: only the middle of the bend is excluded.
- Round bend with a larger radius: nothing is excluded.
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
"""If the direction of the surface near an edge changes by more than this angle, the edge is beside a crease [rad].
The angle is halfway between cloth that lies and cloth that stands upright."""
BESIDE = 0.040
"""Nearer than this to a pinch or a crease, strain is not measured [m]. On coarse meshes, `reach` is larger."""
NO_AREA = 1e-30
"""Lower bound of twice a triangle's area, which avoids a division by zero [m2]."""
MOST_STRAIN = 0.05
"""Edges with more strain than this are counted in the figures."""


@dataclass(frozen=True, eq=False)
class EdgeStrains:
    """Strains of k edges that are away from pinches and fold lines. strain: (k,) positive for elongated edges.
    turn: (k,) largest angle between two triangles of one layer within reach of the edge [rad]."""

    strain: Array
    turn: Array

    def away(self, turn: float = TURN) -> Array:
        """Return the strains of the edges near which the cloth turns by at most `turn` [rad]."""
        return np.asarray(self.strain[self.turn <= turn])


def reach(mesh: ClothMesh) -> float:
    """Distance from a pinch or a crease up to which strain is not measured [m]: BESIDE, but at least two edge
    lengths."""
    return max(BESIDE, 2.0 * float(np.median(mesh.edge_length)))


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


def turns(mesh: ClothMesh, x: Array) -> Array:
    """Compute, for each vertex, the largest angle (n,) [rad] between two triangles of one layer whose middles, on
    the undeformed mesh, are within reach of the vertex.

    The vertex can belong to another layer, because layers are creased together.
    """
    p = x[mesh.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    # A triangle without area has no normal (its vector is zero), so it counts as turned by 90 degrees.
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
    """Return (n,) whether each vertex, of any layer, is within reach of one of `points` (k, 2), given in material
    coordinates."""
    if len(points) == 0:
        return np.zeros(len(mesh.rest), dtype=bool)
    return np.asarray(cKDTree(points).query(mesh.rest)[0] <= reach(mesh))
