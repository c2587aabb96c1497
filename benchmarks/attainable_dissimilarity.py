"""D_relax: how well a fold can end at all, the yardstick of the optimiser.

    python -m benchmarks.attainable_dissimilarity [GARMENT...]

From the garment as the earlier steps leave it, made ideally and settled, the fold is made without grippers
(benchmarks/turn_fold.py): what lies flat is put exactly on its target, the isometry of this fold and those before
with layers at k x thickness. Then it settles for one second. What D is left is due to the cloth: creases open, and
those of earlier folds lift what comes to lie on them. D is the paper's: 3-D, unaligned, over all layers,
area-weighted over barycentres; triangles are cut at the fold lines, so that each has one place in the target.

Vertices are not simply mapped. An earlier crease, some 20 mm high, would be squeezed into the height of its layers
and the strain would fling the cloth about; were it flat instead, it would have to open under the layers that now
lie on it. And where several layers are folded at once, mapped triangles across the line pass through one another:
130 to 1500 crossings, which stay for good and hold the crease shut. That figure is printed beside ours (flat_mm,
with flat_crossings): of single layers on a first fold, where there is nothing to cross, both are alike. Cutting
the simulated mesh at the line does not help: the crease locks onto the row of vertices and does not open at all.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.turn_fold import turned_over
from cell.config.garments.garment_file import list_garments, load_garment
from cell.simulation.scoring.folded_mesh import fold_mesh
from cell.simulation.scoring.score import FinalGarment, named_edge_pairs, score
from skills.cloth.intersections.crossings import count_crossings
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.settings import SolverSettings
from skills.cloth.solver import ClothSimulation
from skills.garments.garment import Garment
from skills.planning.folding import fold_points, outline_of, target_vertices
from skills.planning.plan import plan_folds
from skills.vocabulary import Array, FoldLine, Material, frozen

EDGE, FINER = 0.018, 0.85
"""Edge length of the evaluation mesh [m], and its share of the optimiser's, at most."""
SETTLE_S = 1.0

_SETTLED: dict[tuple[object, ...], Array] = {}
"""What was settled in this process: a later step begins with it."""


def d_relax(
    mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, settings: SolverSettings | None = None
) -> tuple[float, Array]:
    """D_relax [m] of the step whose line is the last of `lines`, and the settled vertices (n, 3)."""
    x = ideal_fold(mesh, lines, material, settings)
    return distance_to_target(mesh, lines, material, x), x


def ideal_fold(
    mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, settings: SolverSettings | None = None
) -> Array:
    """(n, 3) after all folds were made without grippers, each settled before the next; no line: laid flat."""
    if not lines:
        return mesh.lay_flat(material.thickness)
    settings = settings or SolverSettings()
    shapes = [mesh.rest, mesh.layer, *(a for line in lines for a in (line.point, line.direction))]
    key = (*(shape.tobytes() for shape in shapes), material, settings)
    if key not in _SETTLED:
        before = ideal_fold(mesh, lines[:-1], material, settings)
        turned = turned_over(mesh, lines, material, before, settings)
        _SETTLED[key] = frozen(settled(mesh, material, turned, settings))
    return _SETTLED[key]


def mapped_fold(mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material) -> Array:
    """(n, 3) where each vertex, put on its target, has settled: all creases start flat and sharp."""
    return settled(mesh, material, target_vertices(mesh, lines, material), SolverSettings())


def settled(mesh: ClothMesh, material: Material, start: Array, settings: SolverSettings) -> Array:
    """(n, 3) a second after `start` (n, 3), with no gripper."""
    simulation = ClothSimulation(mesh, material, start, settings)
    simulation.advance(frames=round(SETTLE_S * settings.frame_rate))
    return simulation.positions


def distance_to_target(mesh: ClothMesh, lines: tuple[FoldLine, ...], material: Material, x: Array) -> float:
    """The paper's D [m] of a shape (n, 3) against the ideal fold, on triangles cut at the fold lines."""
    cut = fold_mesh(mesh.rest, mesh.triangles, lines, np.column_stack([mesh.rest, mesh.layer, x]))
    centre = cut.attributes[cut.triangles].mean(axis=1)
    sheets = int(mesh.layer.max()) + 1
    folded = fold_points(lines, centre[:, :2], outline_of(mesh), np.rint(centre[:, 2]).astype(int), sheets)
    height = (folded.layers + 0.5) * material.thickness
    target = np.column_stack([folded.positions, height])
    return float(np.average(np.linalg.norm(centre[:, 3:] - target, axis=1), weights=cut.area))


def evaluation_edge(garment: Garment, scale: float = 1.0) -> float:
    """Edge length [m] of the mesh that judges a garment's folds, in another size if asked."""
    return min(EDGE, FINER * garment.mesh_edge_m * scale)


def table(garment: Garment) -> list[dict[str, float | int | str | bool]]:
    """One row a step: D_relax, and what the scorer says of the settled ideal shape."""
    state = garment.flat_state(*garment.poses.middle)
    mesh = mesh_from_contour(state.contour, evaluation_edge(garment), garment.layers)
    rows: list[dict[str, float | int | str | bool]] = []
    steps = plan_folds(state, garment).unwrap()
    for step in steps:
        d, x = d_relax(mesh, step.lines, garment.material)
        flat = mapped_fold(mesh, step.lines, garment.material)
        last = step is steps[-1]
        pairs = named_edge_pairs(garment.edge_pairs, state.keypoints) if last else ()
        judged = score(FinalGarment(x, mesh.triangles, mesh.rest, step.lines, garment.material.thickness, pairs))
        rows.append({
            "garment": garment.name, "step": step.name, "d_relax_mm": round(1e3 * d, 2),
            "crossings": count_crossings(x, mesh.triangles),
            "flat_mm": round(1e3 * distance_to_target(mesh, step.lines, garment.material, flat), 2),
            "flat_crossings": count_crossings(flat, mesh.triangles), "score_fails": ",".join(judged.failed),
            **{k: round(f.value, 4) for k, f in judged.figures.items()},
        })  # fmt: skip
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
