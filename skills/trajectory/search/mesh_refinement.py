"""Transfers a fold problem to a finer mesh, to detect results that depend on the mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.fold_plan.crease_mesh import mesh_near_creases
from foldcell.skills.fold_plan.folding import crease_segments
from foldcell.skills.plane import barycentric
from foldcell.skills.trajectory.search.problem import FoldProblem
from foldcell.skills.vocabulary import Array

__all__ = ["carried", "refined"]

EDGE_QUANTILES = (0.25, 0.95)
"""Two quantiles of the areas of a mesh's triangles. The first is taken as the area of a triangle near creases, the
second as the area of one away from creases."""


def refined(problem: FoldProblem, share: float) -> FoldProblem:
    """Return `problem` on a mesh with edges `share` times as long, with the garment in the same shape. The mesh is
    finer near the creases of this fold and of the earlier ones, as the problem's own mesh is."""
    mesh = problem.mesh
    # edges of equilateral triangles of the same areas
    fine, coarse = np.sqrt(4.0 / np.sqrt(3.0) * np.quantile(mesh.area, EDGE_QUANTILES))
    outline = shapely.union_all(shapely.polygons(mesh.rest[mesh.triangles[mesh.triangle_layer == 0]]))
    contour = shapely.get_coordinates(outline.exterior)[:-1]
    if not outline.exterior.is_ccw:
        contour = contour[::-1]
    creases = crease_segments(problem.step.lines, contour)
    layers = int(mesh.layer.max()) + 1
    finer = mesh_near_creases(
        contour, share * coarse, layers, 0.0, creases, problem.material.bending_length, share * fine
    )
    return replace(problem, mesh=finer, positions=carried(mesh, problem.positions, finer.rest, finer.layer))


def carried(mesh: ClothMesh, positions: Array, rest: Array, layer: NDArray) -> Array:
    """Return (m, 3): the positions of material points on a mesh whose vertices are at `positions` (n, 3). The
    points are given by rest (m, 2) and layer (m,).

    A point outside the mesh, as on a resampled border, is extrapolated from the nearest triangle.
    """
    out = np.empty((len(rest), 3))
    for sheet in np.unique(layer):
        own = np.flatnonzero(layer == sheet)
        triangles = mesh.triangles[mesh.triangle_layer == sheet]
        corners = mesh.rest[triangles]
        nearest = shapely.STRtree(shapely.polygons(corners)).nearest(shapely.points(rest[own]))
        weights = barycentric(corners[nearest], rest[own])
        out[own] = np.einsum("ik,ikd->id", weights, positions[triangles[nearest]])
    return out
