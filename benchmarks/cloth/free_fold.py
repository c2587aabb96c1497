"""Measures the height of settled creases over the edge length of the mesh, and writes docs/results/creases.md.

    python -m benchmarks.cloth.free_fold

A strip of one layer, folded over with nothing pressing on it, has a crease that is 0.907 bending lengths high (a
heavy elastica: `elastica_height`). Folds of two layers and folds over folds have no closed form; their heights are
compared between meshes. Each fold is made without grippers and settles for one second.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.attainable_dissimilarity import ideal_fold
from benchmarks.results_page import table
from foldcell.calibration.free_fold import elastica_height
from foldcell.skills.cloth.contact.contacts import PHASE
from foldcell.skills.cloth.elasticity import stretch_excess
from foldcell.skills.cloth.mesh import ClothMesh, FineBands, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.fold_figures.fold_figures import TableRaster
from foldcell.skills.fold_plan.folding import crease_segments
from foldcell.skills.vocabulary import FoldLine, Material, frozen

PAGE = Path(__file__).resolve().parents[2] / "docs" / "results" / "creases.md"
SHEET = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.2], [0.0, 0.2]])
LINES = (
    FoldLine(frozen(np.array([0.2, 0.1])), frozen(np.array([0.0, 1.0]))),
    FoldLine(frozen(np.array([0.1, 0.1])), frozen(np.array([-1.0, 0.0]))),
)
"""The first fold halves the sheet along x; the second one halves the result along y."""
SHARES = (1.3, 0.87, 0.6, 0.5, 0.4)
"""Edge lengths near the creases, in bending lengths. The cell uses 0.6."""
TURNS = (0.07, 0.3, 0.7)
"""Turns of the mesh's grid [rad]. At 0.3, its rows are nearly parallel to the first crease."""
COARSEST = 0.0265
MOST_EXCESS = 1.5e-3
"""Largest estimated error of the stretch, as a fraction of the length. It is larger than the cell's, because some
of these meshes are finer."""
BESIDE = 0.040
"""Heights are measured up to this distance from a crease [m]."""


@dataclass(frozen=True)
class Case:
    title: str
    layers: int
    folds: int
    bending_length: float
    thickness: float


CASES = (
    Case("one layer", 1, 1, 0.009, 0.0006),
    Case("one layer", 1, 1, 0.015, 0.0006),
    Case("one layer", 1, 1, 0.025, 0.0006),
    Case("two layers", 2, 1, 0.0115, 0.0008),
    Case("two layers", 2, 1, 0.018, 0.0010),
    Case("one layer, folded twice", 1, 2, 0.017, 0.0025),
    Case("two layers, folded twice", 2, 2, 0.0135, 0.0008),
)


def _substeps(mesh: ClothMesh, material: Material) -> int:
    """Return the fewest substeps per frame with which the estimated error of the stretch is small enough."""
    frame = SolverSettings().frame
    accurate = (n for n in range(16, 65, PHASE) if stretch_excess(mesh, material, frame / n, 1.0) <= MOST_EXCESS)
    return next(accurate)


def crease_height(case: Case, share: float, turn: float) -> tuple[float, int]:
    """Return the height of the last crease above the flat layers beneath it [m], and the number of vertices. The
    height is the median, along the crease, of the highest places. share: edge length near the creases in bending
    lengths; turn: of the grid [rad]."""
    lines = LINES[: case.folds]
    material = Material(0.2, 0.02, case.bending_length, case.thickness, 0.4, 0.34, 0.6)
    width = 2.5 * case.bending_length + 0.010
    bands = FineBands(crease_segments(lines, SHEET), width, share * case.bending_length)
    coarsest = max(COARSEST, share * case.bending_length)
    mesh = mesh_from_contour(SHEET, coarsest, case.layers, turn, bands)
    x = ideal_fold(mesh, lines, material, SolverSettings(substeps=_substeps(mesh, material)))
    raster = TableRaster.around(x[:, :2])
    top, _ = raster.render(x, mesh.triangles)
    pixels = np.argwhere(np.isfinite(top))
    xy, z = raster.origin + 0.001 * pixels[:, ::-1], top[*pixels.T]
    line = lines[-1]
    near = np.abs(line.signed_distance(xy)) < BESIDE
    along = (xy[near] - line.point) @ line.direction
    slices = np.floor(along / 0.005).astype(int)
    inner = [k for k in np.unique(slices) if along.min() + 0.02 < 0.005 * k < along.max() - 0.02]
    highest = [z[near][slices == k].max() for k in inner]
    return float(np.median(highest)) - case.thickness, len(mesh.rest)


def measured() -> Iterator[tuple[Case, float, list[float], int]]:
    """Yield, for each case and edge length, the heights on the meshes of all turns [m] and the largest number of
    vertices."""
    for case in CASES:
        for share in SHARES:
            found = [crease_height(case, share, turn) for turn in TURNS]
            yield case, share, [height for height, _ in found], max(n for _, n in found)


def page(rows: Sequence[tuple[Case, float, list[float], int]]) -> str:
    exact = elastica_height()
    lines = []
    for case, share, heights, vertices in rows:
        c = case.bending_length
        relative = (
            " / ".join(f"{h / (exact * c):.2f}" for h in heights) if (case.layers, case.folds) == (1, 1) else ""
        )
        lines.append(
            [case.title, f"{1e3 * c:g}", f"{share:g}", f"{1e3 * share * c:.1f}",
             " / ".join(f"{1e3 * h:.1f}" for h in heights), relative, str(vertices)]
        )  # fmt: skip
    heads = ("crease", "bending length, mm", "edges, bending lengths", "edges, mm", "height, mm", "of elastica",
             "vertices")  # fmt: skip
    return "\n".join(
        [
            "# Results: height of creases over the mesh",
            "",
            "Simulated. A free fold of one layer is exactly",
            f"{exact:.3f} bending lengths high (heavy elastica). Each height is given on three meshes,",
            f"whose grids are turned by {', '.join(f'{t:g}' for t in TURNS)} rad.",
            "World and predictor use 0.6 near creases.",
            "",
            f"Command: `python -m benchmarks.cloth.free_fold`; {platform.machine()}.",
            "",
            table("Heights", heads, lines),
            "",
        ]
    )


def main() -> None:
    rows = []
    for row in measured():
        rows.append(row)
        case, share, heights, vertices = row
        print(f"{case.title:26s} c {1e3 * case.bending_length:5.1f} mm  edges {share:.2f} c  ",
              " ".join(f"{1e3 * h:6.2f}" for h in heights), "mm ", vertices, flush=True)  # fmt: skip
    PAGE.write_text(page(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
