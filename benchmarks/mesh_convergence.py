"""Measures the mesh convergence of the simulated world: the score of a towel, folded twice, over the mesh's edge
length.

    python -m benchmarks.mesh_convergence [GARMENT]

The cloth of an unpressed crease forms a loop, about two bending lengths wide. If the mesh's edges are as long as
that, the loop becomes a polygon that is too high and pushes the layer above away. Fabrics and grasp errors are
drawn as for the simulated world, but with fewer kinds of errors than in noise.yaml. Every mesh gets the same drawn
values. The arcs are plain arcs (PLAIN_H), not optimised.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from cell.config.garments.garment_file import load_garment
from cell.simulation.scoring.score import Score, score_plan
from skills.cloth.mesh import mesh_from_contour
from skills.cloth.predict import predict_fold
from skills.cloth.settings import SolverSettings
from skills.garments.garment import Garment
from skills.planning.plan import plan_folds
from skills.trajectory.frame import frames_of
from skills.trajectory.paths import fold_duration, fold_paths
from skills.vocabulary import FoldStep, Material, frozen

EDGES = (0.026, 0.022, 0.018, 0.015, 0.0125)
"""Edge lengths of the compared meshes [m]. The result with the last one approximates the converged result."""
GRASP_ERROR = 0.003
PLAIN_H = 0.45
SUBSTEPS = 16


def main() -> None:
    parser = argparse.ArgumentParser(description="Score of a folded towel over the edge length of its mesh.")
    parser.add_argument("garment", nargs="?", default="medium_towel")
    parser.add_argument("--worlds", type=int, default=8, help="fabrics drawn (8)")
    options = parser.parse_args()
    garment = load_garment(options.garment, "bare_table")
    print(f"{garment.name}: mean over {options.worlds} drawn fabrics (simulated)")
    print("edge_mm  passed  iou    correspondence_mm  edges_mm  height_mm")
    for edge in EDGES:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            scores = list(pool.map(partial(fold_both, garment, edge), range(options.worlds)))
        mean = {name: np.mean([s.figures[name].value for s in scores]) for name in scores[0].figures}
        passed = sum(s.passed for s in scores)
        print(
            f"{edge * 1e3:7.1f}  {passed:2d}/{len(scores):<3d}  {mean['iou']:.3f}  "
            f"{mean['correspondence_m'] * 1e3:17.1f}  {mean['edges_m'] * 1e3:8.1f}  {mean['height_m'] * 1e3:9.1f}",
            flush=True,
        )


def fold_both(garment: Garment, edge: float, seed: int) -> Score:
    """Draw a towel, make both folds on a mesh of this edge length [m], and return the score."""
    rng = np.random.default_rng(seed)
    fabric = _draw(garment.material, rng)
    state = garment.flat_state(*garment.poses.middle)
    mesh = mesh_from_contour(state.contour, edge, garment.layers, float(rng.uniform(0.2, 0.8)))
    vertices = mesh.lay_flat(fabric.thickness)
    for planned in plan_folds(state, garment).unwrap():
        step = _with_errors(planned, rng)
        arcs = {
            i: frame.denormalise(np.array([[0.25, 0.0, PLAIN_H], [0.75, 0.0, PLAIN_H]]))
            for i, frame in frames_of(step, garment.material.thickness).items()
        }
        headings = {i: grasp.heading for i, grasp in step.grasps.items()}
        paths = fold_paths(arcs, headings, fold_duration(arcs, garment.max_tool_speed))
        settings = SolverSettings(substeps=SUBSTEPS)
        vertices = predict_fold(mesh, vertices, fabric, paths, settings=settings).vertices
    return score_plan(vertices, mesh.triangles, mesh.rest, state.keypoints, garment, fabric.thickness)


def _draw(nominal: Material, rng: np.random.Generator) -> Material:
    def near(value: float, share: float) -> float:
        return value * (1.0 + share * rng.uniform(-1.0, 1.0))

    fabric = replace(
        nominal,
        areal_mass=near(nominal.areal_mass, 0.10),
        bending_length=near(nominal.bending_length, 0.15),
        friction_layers=near(nominal.friction_layers, 0.15),
    )
    return fabric.with_friction(near(nominal.friction_static, 0.10))


def _with_errors(step: FoldStep, rng: np.random.Generator) -> FoldStep:
    grasps = {
        i: replace(g, point=frozen(g.point + rng.normal(0.0, GRASP_ERROR, 2)))
        for i, g in sorted(step.grasps.items())
    }
    return replace(step, grasps=grasps)


if __name__ == "__main__":
    main()
