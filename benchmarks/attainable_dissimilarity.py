"""Computes D_relax, the dissimilarity D of an ideal fold after it has settled. The optimiser is compared with it.

The fold starts from the garment after the earlier steps, each made ideally and settled. It is made without
grippers (skills/fold_plan/turned_fold.py): cloth that lies flat is moved exactly to its target, which is the
isometry of this fold and the earlier ones with layers at k x thickness. The garment then settles for one second.
The remaining D is due to the cloth: creases open, and earlier creases lift the layers above them. D is defined as
in the paper: 3-D, unaligned, over all layers, area-weighted over barycentres. Triangles are cut at the fold
lines, so that each has one place in the target.

It is not enough to move every vertex to its target. An earlier crease, some 20 mm high, would be compressed to
the height of its layers, and the strain would throw the cloth about. If the crease started flat instead, it would
have to open under the layers that now lie on it. Where several layers are folded together, moved triangles at the
line also pass through one another. This causes 130 to 1500 crossings, which remain and hold the crease shut.
Cutting the simulated mesh at the line does not help: the crease then follows the row of vertices and does not
open at all.
"""

from __future__ import annotations

import numpy as np

from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.fold_figures.folded_mesh import fold_mesh
from foldcell.skills.fold_plan.folding import fold_points, outline_of
from foldcell.skills.fold_plan.turned_fold import turned_over
from foldcell.skills.garments.garment import Garment
from foldcell.skills.vocabulary import Array, FoldLine, Material, frozen

EDGE, FINER = 0.018, 0.85
"""Maximum edge length of the evaluation mesh: EDGE [m], and FINER times that of the optimiser's mesh."""
SETTLE_S = 1.0

_SETTLED: dict[tuple[object, ...], Array] = {}
"""Settled shapes that this process has computed. Later steps begin from them, so each is computed once."""


def d_relax(
    mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, settings: SolverSettings | None = None
) -> tuple[float, Array]:
    """Compute D_relax [m] of the step whose line is the last of `lines`, and the settled vertices (n, 3)."""
    x = ideal_fold(mesh, lines, material, settings)
    return distance_to_target(mesh, lines, material, x), x


def ideal_fold(
    mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, settings: SolverSettings | None = None
) -> Array:
    """Make all folds without grippers, and let the garment settle after each. Return the vertices (n, 3). Without
    lines, they are those of the flat garment."""
    if not lines:
        return mesh.lay_flat(material.thickness)
    settings = settings or SolverSettings()
    shapes = [mesh.rest, mesh.layer, *(a for line in lines for a in (line.point, line.direction))]
    key = (*(shape.tobytes() for shape in shapes), material, settings)
    if key not in _SETTLED:
        before = ideal_fold(mesh, lines[:-1], material, settings)
        turned = turned_over(mesh, lines, material, before, settings)
        _SETTLED[key] = frozen(settled(mesh, material, turned, settings, SETTLE_S))
    return _SETTLED[key]


def settled(mesh: ClothMesh, material: Material, start: Array, settings: SolverSettings, settle_s: float) -> Array:
    """Simulate `settle_s` [s] from `start` (n, 3), without grippers. Return the vertices (n, 3)."""
    simulation = ClothSimulation(mesh, material, start, settings)
    simulation.advance(frames=round(settle_s * settings.frame_rate))
    return simulation.positions


def distance_to_target(mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, x: Array) -> float:
    """Compute the paper's D [m] of a shape x (n, 3) from the ideal fold, on triangles cut at the fold lines."""
    cut = fold_mesh(mesh.rest, mesh.triangles, lines, np.column_stack([mesh.rest, mesh.layer, x]))
    centre = cut.attributes[cut.triangles].mean(axis=1)
    sheets = int(mesh.layer.max()) + 1
    folded = fold_points(lines, centre[:, :2], outline_of(mesh), np.rint(centre[:, 2]).astype(int), sheets)
    height = (folded.layers + 0.5) * material.thickness
    target = np.column_stack([folded.positions, height])
    return float(np.average(np.linalg.norm(centre[:, 3:] - target, axis=1), weights=cut.area))


def evaluation_edge(garment: Garment, scale: float = 1.0) -> float:
    """Edge length [m] of the mesh on which a garment's folds are evaluated. scale: factor on the garment's
    size."""
    return min(EDGE, FINER * garment.mesh_edge_m * scale)
