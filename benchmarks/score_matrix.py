"""Scores ideal and spoiled folds of all shipped garments in drawn fabrics, and writes docs/results/score.md.

    python -m benchmarks.score_matrix [GARMENT...] [--fabrics 8] [--workers 2]

The ideal fold has to be valid and to pass. Each kind of failure, at the severity that the score promises to find,
has to fail at least one figure. Failures are made by moving the vertices of the ideal fold.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from benchmarks.results_page import made_by, table
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.noise import load_noise
from foldcell.cell.simulation.scoring.ideal import ideal_of
from foldcell.cell.simulation.truth import GarmentTruth
from foldcell.skills.fold_figures.fold_figures import CREASE_MARGIN, PIXEL, TableRaster
from foldcell.skills.fold_figures.folded_mesh import fold_mesh
from foldcell.skills.fold_plan.folding import fold_xy
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.scoring.alignment import FinalGarment
from foldcell.skills.scoring.score import named_edge_pairs, score
from foldcell.skills.scoring.verdict import IdealHeights, Score
from foldcell.skills.vocabulary import Array, FoldLine

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "score.md"
KINDS = {
    "drift": "the stack lies 60 mm beside its place",
    "pile": "a tenth of the folded area stands 30 mm higher",
    "sag": "half of the moved edge, from one end on, is 40 mm short",
    "dropped_corner": "a corner of the moved part lies 60 mm from its place",
}
"""Kinds of failure that the score finds in every garment."""
OTHER_KINDS = {"sag_middle": "the middle half of the moved edge is 40 mm short, its ends are in place"}
"""Kinds of failure that the score finds only if the moved edge belongs to an edge pair of the garment file."""
DRIFT, PILE, SAG, CORNER = 0.060, 0.030, 0.040, 0.060
"""Severities of the kinds of failure [m]."""
DRIFT_TURN = 2.4
"""Angle between the directions of the two variants of a drift [rad]."""
EDGE_SHARE = 0.9
"""The moved edge reaches at least this share of the largest distance from the fold line."""
PILED_SHARE = 0.10
"""Share of the folded area that a pile covers."""
FADE = 0.03
"""Width over which displacements fade out [m]."""


@dataclass(frozen=True, eq=False)
class IdealGarment:
    """An ideal fold in the garment's own frame. vertices: (n, 3) [m]; lines: of the preferred way; edge_pairs: as
    in FinalGarment."""

    garment: GarmentTruth
    vertices: Array
    lines: tuple[FoldLine, ...]
    edge_pairs: tuple[tuple[Array, Array], ...]
    heights: IdealHeights


def drawn_garment(name: str, seed: int) -> GarmentTruth:
    """Return the flat garment with the fabric and the outline that are drawn for `seed`, in its own frame."""
    return in_own_frame(WorldGarment(load_garment(name), load_noise().garment, np.random.default_rng(seed), False))


def in_own_frame(world: WorldGarment) -> GarmentTruth:
    """Return a garment of the simulated world as it lies flat, in its own frame."""
    c, s = np.cos(world.pose.angle), np.sin(world.pose.angle)
    back = np.array([[c, -s], [s, c]])
    return GarmentTruth(
        name=world.name,
        vertices=world.mesh.lay_flat(world.material.thickness),
        material=world.mesh.rest,
        keypoints={n: (p - (world.pose.x, world.pose.y)) @ back for n, p in world.keypoints.items()},
        pose=(0.0, 0.0, 0.0),
        fabric=world.material,
        layers=world.layers,
        mesh=world.mesh,
        traits=world.traits,
        solver=world.solver,
    )


def ideal_garment(name: str, seed: int) -> IdealGarment:
    """Make the ideal fold of a garment with the fabric and the outline that are drawn for `seed`."""
    garment, plan = drawn_garment(name, seed), load_garment(name)
    lines = ways_to_fold(plan, garment.keypoints)[0]
    folds, heights = ideal_of(garment, plan, lines)
    pairs = named_edge_pairs(plan.edge_pairs, garment.keypoints)
    return IdealGarment(garment, folds[-1].vertices, lines, pairs, heights)


def judged(ideal: IdealGarment, vertices: Array) -> Score:
    """Score a garment that lies at `vertices` (n, 3) against the ideal."""
    garment = ideal.garment
    return score(
        FinalGarment(
            vertices, garment.triangles, garment.material, ideal.lines, garment.thickness, ideal.edge_pairs,
            garment.keypoints, ideal.heights,
        )
    )  # fmt: skip


def spoiled(ideal: IdealGarment, kind: str, variant: int = 0) -> Array:
    """Return the vertices (n, 3) of the ideal fold with a failure of this kind. variant: 0 or 1, another
    direction, place, end or corner."""
    x, line = ideal.vertices.copy(), ideal.lines[-1]
    before = ideal.lines[:-1]
    moved = line.signed_distance(fold_xy(before, ideal.garment.material)) > 0.0
    if kind == "drift":
        angle = variant * DRIFT_TURN
        x[:, :2] += DRIFT * np.array([np.cos(angle), np.sin(angle)])
    elif kind == "pile":
        x[:, 2] += PILE * _in_a_tenth(ideal, variant)
    elif kind in ("sag", "sag_middle"):
        along = (x[:, :2] - line.point) @ line.direction
        share = (along - along[moved].min()) / np.ptp(along[moved])
        fade = FADE / np.ptp(along[moved])
        low, high = ((-1.0, 0.5), (0.5, 2.0))[variant] if kind == "sag" else (0.25, 0.75)
        short = np.clip(np.minimum(share - low, high - share) / fade + 1.0, 0.0, 1.0)
        away = -line.signed_distance(x[:, :2])
        short *= np.where(moved, np.clip(away / away[moved].max(), 0.0, 1.0), 0.0)
        x[:, :2] += SAG * short[:, None] * line.normal
    elif kind == "dropped_corner":
        corner = _corners(ideal)[variant]
        near = np.exp(-(((x[:, :2] - corner) / (2.0 * FADE)) ** 2).sum(axis=1))
        x[:, :2] += np.where(moved, CORNER * near, 0.0)[:, None] * line.normal
    else:
        raise ValueError(f"unknown kind of failure: {kind}")
    return x


def _corners(ideal: IdealGarment) -> tuple[Array, Array]:
    """Return the places (2,) of two corners of the moved part: that of the key point farthest from the fold line,
    and the other end of the moved edge."""
    line, before = ideal.lines[-1], ideal.lines[:-1]
    points = np.array(list(ideal.garment.keypoints.values()))
    corner = points[int(line.signed_distance(fold_xy(before, points)).argmax())]
    reach = line.signed_distance(fold_xy(before, ideal.garment.material))
    edge = fold_xy(ideal.lines, ideal.garment.material[reach > EDGE_SHARE * reach.max()])
    first = fold_xy(ideal.lines, corner)
    return first, edge[int(np.linalg.norm(edge - first, axis=1).argmax())]


def _in_a_tenth(ideal: IdealGarment, variant: int) -> Array:
    """Return (n,) 1 for the vertices in a disc that covers PILED_SHARE of the silhouette, 0 away from it. The
    disc's centre is as far as possible from creases and from the outline. variant 1: from the centre of that disc
    as well."""
    xy = ideal.vertices[:, :2]
    grid = TableRaster.around(xy)
    top, _ = grid.render(ideal.vertices, ideal.garment.triangles)
    silhouette = np.isfinite(top)
    creases = fold_mesh(ideal.garment.material, ideal.garment.triangles, ideal.lines, xy).creases
    inner = silhouette & grid.away_from(creases, CREASE_MARGIN)
    depth = cv2.distanceTransform(inner.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    if variant:
        first = np.array(np.unravel_index(int(depth.argmax()), depth.shape))
        away = np.linalg.norm(np.indices(depth.shape).transpose(1, 2, 0) - first, axis=-1)
        depth = np.where(inner, np.minimum(depth, away), 0.0)
    centre = np.array(np.unravel_index(int(depth.argmax()), depth.shape))[::-1]
    pixels = np.argwhere(silhouette)[:, ::-1]
    radius = float(np.quantile(np.linalg.norm(pixels - centre, axis=1), PILED_SHARE)) * PIXEL
    distance = np.linalg.norm(xy - (grid.origin + PIXEL * centre), axis=1)
    return np.asarray(np.clip(1.0 + (radius - distance) / (0.1 * radius), 0.0, 1.0))


def row(case: tuple[str, int]) -> list[str]:
    """Judge one garment in one fabric. Returns the cells of its row; a wrong verdict is in bold."""
    name, seed = case
    began = time.process_time()
    ideal = ideal_garment(name, seed)
    spent = time.process_time() - began
    perfect = judged(ideal, ideal.vertices)
    wrong = ideal.heights.flaw or ", ".join(perfect.failed)
    cells = [name, str(seed), f"{1e3 * ideal.garment.fabric.bending_length:.1f}",
             "passed" if perfect.passed else f"**{wrong}**"]  # fmt: skip
    for figure in ("iou", "height_m", "crease_height_m", "edges_m", "keypoints_m"):
        value = perfect.figures[figure].value
        cells.append(f"{value:.3f}" if figure == "iou" else f"{1e3 * value:.1f}")
    cells.append(f"{100.0 * ideal.heights.strain:.1f}")
    for kind in (*KINDS, *OTHER_KINDS):
        failed = judged(ideal, spoiled(ideal, kind)).failed
        cells.append(", ".join(failed) or ("**not found**" if kind in KINDS else "not found"))
    return [*cells, f"{spent:.1f}"]


def rows(garments: list[str], seeds: list[int], workers: int) -> Iterator[list[str]]:
    """Judge all garments in all fabrics, in worker processes."""
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(row, product(garments, seeds))


def page(found: list[list[str]], command: str) -> str:
    """Write the results page from the rows."""
    heads = ("garment", "seed", "bending length, mm", "ideal", "IoU", "height, mm", "crease, mm", "edges, mm",
             "key points, mm", "strain, %", *KINDS, *OTHER_KINDS, "CPU, s")  # fmt: skip
    wrong = sum("**" in cell for cells in found for cell in cells)
    lines = [
        "# Results: ideal and spoiled folds under the score",
        "",
        "Simulated. Each row is a garment with the fabric and the outline that are drawn for a seed. It has the",
        "verdict on the ideal fold with its figures, and the figures that each spoiled fold fails. Bold: a wrong",
        "verdict. An ideal fold is not valid if layers pass through each other, an edge away from creases is",
        "strained by more than 5 %, it does not rest, or it overlaps too little with its target.",
        "",
        *(f"- {kind.replace('_', ' ')}: {about}" for kind, about in (KINDS | OTHER_KINDS).items()),
        "",
        "A sag in the middle is found only if the moved edge belongs to an edge pair of the garment file. For",
        "other edges, only key points are compared with their places, and the ends of the edge are in place.",
        "",
        made_by(command),
        f"Wrong verdicts: {wrong} of {len(found) * (1 + len(KINDS))}.",
        "",
        table("Verdicts", heads, found),
        "",
    ]
    return "\n".join(lines)


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
    named = "".join(f" {name}" for name in options.garments)
    command = f"python -m benchmarks.score_matrix{named} --fabrics {options.fabrics}"
    if options.first_seed != parser.get_default("first_seed"):
        command += f" --first-seed {options.first_seed}"
    PAGE.write_text(page(found, command), encoding="utf-8")
    print(PAGE)


if __name__ == "__main__":
    main()
