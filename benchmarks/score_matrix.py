"""Scores ideal and spoiled folds of all shipped garments in drawn fabrics, and writes docs/results/score.md.

    python -m benchmarks.score_matrix [GARMENT...] [--fabrics 8] [--workers 2]

The ideal fold has to pass. Each kind of failure, at the severity that the score promises to find, has to fail at
least one figure. Failures are made by moving the vertices of the ideal fold.
"""

from __future__ import annotations

import argparse
import multiprocessing
import platform
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.results_page import table
from cell.config.garments.garment_file import list_garments, load_garment
from cell.simulation.garment.cloth_body import solver_settings
from cell.simulation.garment.garment import WorldGarment
from cell.simulation.noise import load_noise
from cell.simulation.scoring.ideal import ideal_of
from cell.simulation.scoring.score import FinalGarment, IdealHeights, Score, named_edge_pairs, score
from skills.cloth.mesh import ClothMesh
from skills.planning.folding import fold_xy
from skills.planning.plan import ways_to_fold
from skills.vocabulary import Array, FoldLine

__all__ = ["KINDS", "IdealGarment", "ideal_garment", "judged", "spoiled"]

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "score.md"
KINDS = ("drift", "pile", "sag", "dropped_corner")
DRIFT, PILE, SAG, CORNER = 0.060, 0.030, 0.040, 0.060
"""Severities of the kinds of failure [m]."""
PILED_SHARE = 0.10
"""Share of the folded area that a pile covers."""
FADE = 0.03
"""Width over which displacements fade out [m]."""


@dataclass(frozen=True, eq=False)
class IdealGarment:
    """An ideal fold in the garment's own frame. vertices: (n, 3) [m]."""

    mesh: ClothMesh
    vertices: Array
    lines: tuple[FoldLine, ...]
    keypoints: Mapping[str, Array]
    edge_pairs: tuple[tuple[Array, Array], ...]
    thickness: float
    heights: IdealHeights


def ideal_garment(name: str, seed: int) -> IdealGarment:
    """Make the ideal fold of a garment in the fabric and with the outline of the world `seed`."""
    garment = load_garment(name)
    world = WorldGarment(garment, load_noise().garment, np.random.default_rng(seed), False)
    c, s = np.cos(world.pose.angle), np.sin(world.pose.angle)
    back = np.array([[c, -s], [s, c]])
    keypoints = {n: (p - (world.pose.x, world.pose.y)) @ back for n, p in world.keypoints.items()}
    lines = ways_to_fold(garment, keypoints)[0]
    vertices, heights = ideal_of(world.mesh, lines, world.material, solver_settings(world.traits))
    pairs = named_edge_pairs(garment.edge_pairs, keypoints)
    return IdealGarment(world.mesh, vertices, lines, keypoints, pairs, world.material.thickness, heights)


def judged(ideal: IdealGarment, vertices: Array) -> Score:
    return score(
        FinalGarment(
            vertices, ideal.mesh.triangles, ideal.mesh.rest, ideal.lines, ideal.thickness, ideal.edge_pairs,
            ideal.keypoints, ideal.heights
        )
    )  # fmt: skip


def spoiled(ideal: IdealGarment, kind: str) -> Array:
    """Return the vertices (n, 3) of the ideal fold with a failure of this kind."""
    x = ideal.vertices.copy()
    line = ideal.lines[-1]
    moved = line.signed_distance(fold_xy(ideal.lines[:-1], ideal.mesh.rest)) > 0.0
    if kind == "drift":
        x[:, 0] += DRIFT
    elif kind == "pile":
        x[:, 2] += PILE * _in_a_tenth(x, ideal.lines)
    elif kind == "sag":
        along = (x[:, :2] - line.point) @ line.direction
        low, high = along[moved].min(), along[moved].max()
        half = np.clip((0.5 * (low + high) - along) / FADE + 0.5, 0.0, 1.0)
        away = -line.signed_distance(x[:, :2])
        x[:, :2] += np.where(moved, SAG * half * np.clip(away / away[moved].max(), 0.0, 1.0), 0.0)[:, None] * (
            line.normal
        )
    elif kind == "dropped_corner":
        target = {n: fold_xy(ideal.lines, p) for n, p in ideal.keypoints.items()}
        before = {n: line.signed_distance(fold_xy(ideal.lines[:-1], p)) for n, p in ideal.keypoints.items()}
        corner = target[max(before, key=lambda n: before[n])]
        near = np.exp(-(((x[:, :2] - corner) / (2.0 * FADE)) ** 2).sum(axis=1))
        x[:, :2] += np.where(moved, CORNER * near, 0.0)[:, None] * line.normal
    else:
        raise ValueError(f"unknown kind of failure: {kind}")
    return x


def _in_a_tenth(x: Array, lines: tuple[FoldLine, ...]) -> Array:
    """Return (n,) 1 for the top layers of a disc, away from the last lines, that covers a tenth of the
    silhouette."""
    xy = x[:, :2]
    area = float(np.prod(np.ptp(xy, axis=0)))
    away = np.min([np.abs(line.signed_distance(xy)) for line in lines], axis=0)
    centre = xy[np.argmax(np.minimum(away, _from_border(xy)))]
    radius = np.sqrt(PILED_SHARE * area / np.pi)
    distance = np.linalg.norm(xy - centre, axis=1)
    return np.asarray(np.clip((radius - distance) / (0.1 * radius) + 1.0, 0.0, 1.0) * (x[:, 2] > 0.0))


def _from_border(xy: Array) -> Array:
    low, high = xy.min(axis=0), xy.max(axis=0)
    return np.minimum(xy - low, high - xy).min(axis=1)


def row(case: tuple[str, int]) -> list[str]:
    """Judge one garment in one fabric. Returns the cells of its row."""
    name, seed = case
    ideal = ideal_garment(name, seed)
    perfect = judged(ideal, ideal.vertices)
    cells = [
        name,
        str(seed),
        "passed" if perfect.passed else f"**{ideal.heights.flaw or ', '.join(perfect.failed)}**",
    ]
    for figure in ("iou", "height_m", "crease_height_m", "edges_m", "keypoints_m"):
        value = perfect.figures[figure].value
        cells.append(f"{value:.3f}" if figure == "iou" else f"{1e3 * value:.1f}")
    for kind in KINDS:
        found = judged(ideal, spoiled(ideal, kind))
        cells.append(", ".join(found.failed) if not found.passed else "**passed**")
    return cells


def rows(garments: list[str], seeds: list[int], workers: int) -> Iterator[list[str]]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield from pool.map(partial(row), product(garments, seeds))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("garments", nargs="*", help="names; default: all that ship")
    parser.add_argument("--fabrics", type=int, default=8, help="fabrics drawn for each garment (8)")
    parser.add_argument("--first-seed", type=int, default=9001)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = list(range(options.first_seed, options.first_seed + options.fabrics))
    found = []
    for cells in rows(options.garments or list(list_garments()), seeds, options.workers):
        print("  ".join(cells), flush=True)
        found.append(cells)
    heads = ("garment", "seed", "ideal", "IoU", "height, mm", "crease, mm", "edges, mm", "key points, mm",
             "drift 60 mm", "pile 30 mm", "sag 40 mm", "corner 60 mm")  # fmt: skip
    wrong = sum("**" in cell for cells in found for cell in cells)
    text = [
        "# Results: ideal and spoiled folds under the score",
        "",
        "Simulated. For each garment and drawn fabric: the verdict on the ideal fold with its figures,",
        "and the figures that each spoiled fold fails.",
        "",
        f"Command: `python -m benchmarks.score_matrix --fabrics {options.fabrics}`; {platform.machine()}.",
        f"Wrong verdicts: {wrong} of {len(found) * (1 + len(KINDS))}.",
        "",
        table("Verdicts", heads, found),
        "",
    ]
    PAGE.write_text("\n".join(text), encoding="utf-8")
    print(f"{wrong} wrong verdicts; {PAGE}")


if __name__ == "__main__":
    main()
