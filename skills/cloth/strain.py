"""Computes the strain of edges that are away from creases.

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

import numpy as np
from scipy.spatial import cKDTree

from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, Index

TURN = np.deg2rad(45.0)
"""If the direction of the surface near an edge changes by more than this angle, the edge is beside a crease [rad].
The angle is halfway between cloth that lies and cloth that stands upright."""
BESIDE = 0.040
"""Strain is not measured nearer than this to a crease [m]. On coarse meshes, `reach` is larger."""
MOST_STRAIN = 0.05
"""Largest acceptable strain of an edge away from creases, as a fraction."""
IGNORED = 0.01
"""Smaller strains are not examined."""
NO_AREA = 1e-30
"""Lower bound of twice a triangle's area, which avoids a division by zero [m2]."""


def reach(mesh: ClothMesh) -> float:
    """Distance from a crease up to which strain is not measured [m]: BESIDE, but at least two edge lengths."""
    return max(BESIDE, 2.0 * float(np.median(mesh.edge_length)))


def largest_strain(mesh: ClothMesh, x: Array) -> float:
    """Return the largest strain (elongation or compression) of an edge that is not beside a crease, as a fraction
    of its length, for cloth at x (n, 3). If it is at most IGNORED, IGNORED is returned."""
    now = np.linalg.norm(x[mesh.edges[:, 0]] - x[mesh.edges[:, 1]], axis=1)
    strain = np.abs(now / mesh.edge_length - 1.0)
    candidates = np.flatnonzero(strain > IGNORED)
    candidates = candidates[np.argsort(-strain[candidates])]
    for lot in np.array_split(candidates, max(1, len(candidates) // 32)):
        vertices, place = np.unique(mesh.edges[lot], return_inverse=True)
        turned = turns(mesh, x, vertices)[place.reshape(-1, 2)].max(axis=1, initial=0.0)
        away = lot[turned <= TURN]
        if len(away):
            return float(strain[away[0]])
    return IGNORED


def turns(mesh: ClothMesh, x: Array, vertices: Index | None = None) -> Array:
    """Compute, for each of `vertices` (k,) (default: all), the largest angle (k,) [rad] between two triangles of
    one layer whose middles, on the undeformed mesh, are within reach of the vertex.

    The vertex can belong to another layer, because layers are creased together.
    """
    rest = mesh.rest if vertices is None else mesh.rest[vertices]
    p = x[mesh.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    # A triangle without area has no normal (its vector is zero), so it counts as turned by 90 degrees.
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), NO_AREA)
    middle = mesh.rest[mesh.triangles].mean(axis=1)
    places, place = np.unique(rest, axis=0, return_inverse=True)
    least = np.ones(len(places))  # smallest cosine of an angle between normals
    for layer in np.unique(mesh.triangle_layer):
        own = np.flatnonzero(mesh.triangle_layer == layer)
        for k, near in enumerate(cKDTree(middle[own]).query_ball_point(places, reach(mesh))):
            directions = normal[own[near]]
            least[k] = min(least[k], (directions @ directions.T).min(initial=1.0))
    return np.asarray(np.arccos(np.clip(least, -1.0, 1.0))[place.reshape(-1)])
