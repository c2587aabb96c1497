"""Meshes of a garment that are fine near the creases of its plan.

A simulated crease has the height that its fabric gives it only if the mesh resolves the crease's loop. This loop
is 4.7 bending lengths long. A mesh that is fine everywhere would cost too much.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from foldcell.skills.cloth.mesh import ClothMesh, FineBands, mesh_from_contour
from foldcell.skills.fold_plan.folding import crease_segments
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import Array, GarmentState

EDGE_SHARE = 0.6
"""Edge length near creases, in bending lengths. With longer edges, a free fold deviates from the elastica by more
than 10 % on some meshes (benchmarks/cloth/free_fold.py)."""
LOOP_SHARE = 2.5
"""Half the length of a crease's loop, in bending lengths, rounded up."""
COARSER = 1.15
"""Largest edge length of the predictor's meshes away from creases, relative to the garment's `mesh_edge_m`."""
ASTRAY = 0.010
"""Distance by which a crease may lie beside its planned line [m]."""


def creases_of(garment: Garment, keypoints: Mapping[str, Array], outline: Array) -> Array:
    """Return (c, 2, 2): the creases of all ways to fold the garment, in the coordinates of its key points and of
    its outline (k, 2) [m]."""
    return np.concatenate([crease_segments(lines, outline) for lines in ways_to_fold(garment, keypoints)])


def mesh_near_creases(
    contour: Array,
    coarsest: float,
    layers: int,
    rotate: float,
    creases: Array,
    bending_length: float,
    edge: float | None = None,
) -> ClothMesh:
    """Mesh a garment finely near its creases (c, 2, 2). edge: length of the edges near creases [m], by default
    EDGE_SHARE bending lengths. coarsest: largest length of the edges elsewhere [m]. The other arguments are those
    of `mesh_from_contour`."""
    finest = EDGE_SHARE * bending_length if edge is None else edge
    bands = FineBands(creases, LOOP_SHARE * bending_length + ASTRAY, finest)
    return mesh_from_contour(contour, max(coarsest, finest), layers, rotate, bands)


def predictor_mesh(state: GarmentState, garment: Garment) -> ClothMesh:
    """Mesh a flat garment as the predictor sees it, with the nominal bending length of its fabric."""
    creases = creases_of(garment, state.keypoints, state.contour)
    coarsest = max(COARSER * garment.mesh_edge_m, 2.0 * EDGE_SHARE * garment.material.bending_length)
    return mesh_near_creases(
        state.contour, coarsest, garment.layers, 0.0, creases, garment.material.bending_length
    )
