"""Benchmark of friction learning: does friction learned from one fold improve the next fold?

    python -m benchmarks.adaptation [GARMENT...] [--seeds N] [--friction LOW HIGH]

A world is drawn for each seed. It differs from the executive's prediction in its friction, its mesh and slightly
in its bending stiffness; its hands lean and its tools are off target. The second-to-last fold is made in this
world. Only the outline of the result is observed, with the error of a camera.

The arcs of the last fold are then chosen three times: with the friction of the garment file, with the learned
friction (calibration/identify.py, bounded as in a run), and with the world's true friction. The third choice shows
the best result that any learning could reach. Each choice is made as in a run: it takes the arcs of a search with
the nominal fabric if they reach their promised D, otherwise the result of a search that begins from them. All
choices are executed in the same world with the same errors. The result is D on the world's mesh.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import shapely

from benchmarks.attainable_dissimilarity import distance_to_target, ideal_fold
from foldcell.calibration.identify import (
    SIGMA,
    identify_friction,
    outline_residual,
    predict_candidates,
    silhouette,
)
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.cell.executive.effects.adapting import FACTORS
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.paths import fold_paths, lifted
from foldcell.skills.trajectory.search.optimise import optimise_fold
from foldcell.skills.vocabulary import FoldStep, GraspId, GraspTrajectory, Material, ToolPath

SEEN_SIGMA, SEEN_LENGTH = 0.0015, 0.05
"""Standard deviation of the error of an observed outline, and correlation length of this error along the
outline [m]."""
FINER = 0.85
BUDGET = 25


@dataclass(frozen=True, eq=False)
class World:
    """One drawn world. mesh, material: of its garment. lean: of each hand [rad]. off: (3,) offset of the
    tools [m]."""

    mesh: ClothMesh
    material: Material
    lean: Mapping[GraspId, float]
    off: Array

    @classmethod
    def draw(cls, garment: Garment, contour: Array, friction: tuple[float, float], seed: int) -> World:
        rng = np.random.default_rng(seed)
        m = garment.material
        fabric = replace(
            m.with_friction(m.friction_static * rng.uniform(*friction)),
            bending_length=m.bending_length * rng.uniform(0.85, 1.15),
        )
        edge = FINER * garment.mesh_edge_m * rng.uniform(0.95, 1.05)
        mesh = mesh_from_contour(contour, edge, garment.layers, float(rng.uniform(0.2, 0.8)))
        lean = {i: float(rng.uniform(-0.12, 0.12)) for i in GraspId}
        return cls(mesh, fabric, lean, np.append(rng.uniform(-0.003, 0.003, 2), 0.0))

    def fold(self, positions: Array, step: FoldStep, trajectory: GraspTrajectory) -> Array:
        """Make the fold with this world's fabric and errors. Return the vertices (n, 3) after it."""
        executed = {
            i: replace(path, position=path.position + self.off, pitch=path.pitch + self.lean[i])
            for i, path in planned(step, trajectory).items()
        }
        return predict_fold(self.mesh, positions, self.material, executed).vertices


def planned(step: FoldStep, trajectory: GraspTrajectory) -> dict[GraspId, ToolPath]:
    headings = {i: grasp.heading for i, grasp in step.grasps.items()}
    arcs = fold_paths(trajectory.control_points, headings, trajectory.duration)
    return {i: lifted(path, 0.03) for i, path in arcs.items()}


def seen(shape: shapely.Geometry, rng: np.random.Generator) -> Array:
    """Return the outline (k, 2) of a shape as a camera would observe it, with an error that is correlated along
    the outline [m]."""
    ring = max(getattr(shape, "geoms", [shape]), key=lambda part: part.area).exterior
    k = max(24, round(ring.length / SEEN_LENGTH))
    error = np.repeat(rng.normal(0.0, SEEN_SIGMA, (k, 2)), 4, axis=0)
    points = shapely.line_interpolate_point(ring, np.arange(4 * k) / (4 * k), normalized=True)
    return shapely.get_coordinates(points) + error


class Choice:
    """Chooses the arcs of one fold for a believed fabric, as a run does."""

    def __init__(self, garment: Garment, step: FoldStep, mesh: ClothMesh, threads: ThreadPoolExecutor) -> None:
        self.garment, self.step, self.mesh, self.threads = garment, step, mesh, threads

    def __call__(self, before: Array, material: Material, known: GraspTrajectory | None) -> GraspTrajectory | None:
        return optimise_fold(
            self.step, self.mesh, before, material, budget=BUDGET, executor=self.threads,
            max_tool_speed=self.garment.max_tool_speed, start=dict(known.control_points) if known else None,
            promised=known.dissimilarity if known else None,
            promised_initial=known.dissimilarity_initial if known else None,
        ).value  # fmt: skip


def compare(name: str, seeds: Sequence[int], friction: tuple[float, float]) -> list[dict[str, float | str]]:
    """Compute one row per seed: true and learned friction relative to the friction of the garment file; D [mm]
    without learning, with learning, and with the true friction."""
    garment = load_garment(name, "bare_table")
    state = garment.flat_state(*garment.poses.middle)
    *_, first, last = plan_folds(state, garment).unwrap()
    m = garment.material
    mesh = mesh_from_contour(state.contour, garment.mesh_edge_m, garment.layers)
    rows: list[dict[str, float | str]] = []
    with ThreadPoolExecutor(2) as threads:
        flat = ideal_fold(mesh, first.earlier, m)
        one = Choice(garment, first, mesh, threads)(flat, m, None)
        assert one is not None, f"{name}: no arcs for {first.name}"
        believed = predict_fold(mesh, flat, m, planned(first, one)).vertices
        choose = Choice(garment, last, mesh, threads)
        known = choose(believed, m, None)
        assert known is not None, f"{name}: no arcs for {last.name}"
        for seed in seeds:
            world = World.draw(garment, state.contour, friction, seed)
            lies = world.fold(ideal_fold(world.mesh, first.earlier, m), first, one)
            outline = seen(silhouette(lies, world.mesh.triangles), np.random.default_rng(seed))
            residual = outline_residual(outline, believed, mesh.triangles)
            learned, share = m, 0.0
            if residual >= SIGMA:
                grid = predict_candidates(mesh, flat, m, planned(first, one), FACTORS)
                estimate = identify_friction(outline, grid, m)
                learned, share = estimate.update_of(m, m), estimate.learned
            ended = {}
            for arm, fabric in (("off", m), ("on", learned), ("known", world.material)):
                same = fabric == m
                found = known if same else choose(believed, m.with_friction(fabric.friction_static), known)
                after = world.fold(lies, last, found) if found else lies
                ended[arm] = 1e3 * distance_to_target(world.mesh, last.lines, m, after)
            rows.append({
                "garment": name, "seed": seed, "friction": world.material.friction_static / m.friction_static,
                "learned_friction": learned.friction_static / m.friction_static, "learned": share,
                "residual_mm": 1e3 * residual, **{f"D_{arm}_mm": d for arm, d in ended.items()},
            })  # fmt: skip
            print({k: round(v, 3) if isinstance(v, float) else v for k, v in rows[-1].items()}, flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("garments", nargs="*", default=["small_towel"])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--friction", type=float, nargs=2, default=(0.65, 1.35), metavar=("LOW", "HIGH"))
    arguments = parser.parse_args()
    for name in arguments.garments:
        rows = compare(name, range(1, arguments.seeds + 1), tuple(arguments.friction))
        d = np.array([[r["D_off_mm"], r["D_on_mm"], r["D_known_mm"]] for r in rows], dtype=float)
        off, on, known = d.mean(axis=0)
        moved = sum(r["learned_friction"] != 1.0 for r in rows)
        print(f"{name}: D {off:.2f} mm without, {on:.2f} with, {known:.2f} mm knowing the friction; learned in"
              f" {moved} of {len(rows)} worlds; paired difference {np.mean(d[:, 1] - d[:, 0]):+.2f} mm"
              f" (largest {np.max(d[:, 1] - d[:, 0]):+.2f})", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
