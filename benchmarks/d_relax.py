"""D_relax: how well a fold can end at all, the yardstick of the optimiser.

    python -m benchmarks.d_relax [GARMENT...]

For each step the mesh is put exactly on the target (the isometry of this fold and those before, layers at
k x thickness) and settles for one second with no gripper. What D is then left is due to the cloth: creases
open. D is the paper's: 3-D, unaligned, over all layers, area-weighted over barycentres; triangles are cut at
the fold lines, so that each has one place in the target.

Creases of earlier folds start flat as well. To map them as they had settled squeezes their bulges into the
height of the layers, and the strain flings the cloth about.
"""

from __future__ import annotations

import argparse

import numpy as np

from cell.garments import list_garments, load_garment
from cell.simulation.score import FinalGarment, fold_mesh, named_edge_pairs, score
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.solver import ClothSimulation, SolverSettings
from skills.garments.garment import Garment
from skills.planning.folding import fold_points, outline_of, target_vertices
from skills.planning.plan import plan_folds
from skills.vocabulary import Array, FoldLine, Material

EDGE = 0.018
"""Edge length of the evaluation mesh [m]: finer than the optimiser's."""
SETTLE_S = 1.0


def d_relax(
    mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, settings: SolverSettings | None = None
) -> tuple[float, Array]:
    """D_relax [m] of the step whose line is the last of `lines`, and the settled vertices (n, 3)."""
    settings = settings or SolverSettings()
    start = target_vertices(mesh, lines, material) + np.array([0.0, 0.0, 0.5 * material.thickness])
    simulation = ClothSimulation(mesh, material, start, settings)
    simulation.advance(frames=round(SETTLE_S * settings.frame_rate))
    x = simulation.positions
    return distance_to_target(mesh, lines, material, x), x


def distance_to_target(mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, x: Array) -> float:
    """The paper's D [m] of a shape (n, 3) against the ideal fold, on triangles cut at the fold lines."""
    cut = fold_mesh(mesh.rest, mesh.triangles, lines, np.column_stack([mesh.rest, mesh.layer, x]))
    centre = cut.attributes[cut.triangles].mean(axis=1)
    sheets = int(mesh.layer.max()) + 1
    folded = fold_points(lines, centre[:, :2], outline_of(mesh), np.rint(centre[:, 2]).astype(int), sheets)
    height = (folded.layers + 0.5) * material.thickness
    target = np.column_stack([folded.positions, height])
    return float(np.average(np.linalg.norm(centre[:, 3:] - target, axis=1), weights=cut.area))


def table(garment: Garment) -> list[dict[str, float | int | str | bool]]:
    """One row a step: D_relax, and what the scorer says of the settled ideal shape."""
    state = garment.flat_state(*garment.poses.middle)
    mesh = mesh_from_contour(state.contour, EDGE, garment.layers)
    rows: list[dict[str, float | int | str | bool]] = []
    steps = plan_folds(state, garment).unwrap()
    for step in steps:
        d, x = d_relax(mesh, step.lines, garment.material)
        last = step is steps[-1]
        pairs = named_edge_pairs(garment.edge_pairs, state.keypoints) if last else ()
        judged = score(FinalGarment(x, mesh.triangles, mesh.rest, step.lines, garment.material.thickness, pairs))
        failed = ",".join(judged.failed)
        rows.append({"garment": garment.name, "step": step.name, "d_relax_mm": 1e3 * d, "score_fails": failed,
                     **{k: round(f.value, 4) for k, f in judged.figures.items()}})  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("garments", nargs="*", help="names; default: all that ship")
    parser.add_argument("--surface", default="bare_table")
    arguments = parser.parse_args()
    for name in arguments.garments or list_garments():
        for row in table(load_garment(name, arguments.surface)):
            print(row, flush=True)


if __name__ == "__main__":
    main()
