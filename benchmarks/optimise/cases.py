"""Prepares one step of one garment for folding, and evaluates its arcs."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.attainable_dissimilarity import d_relax, distance_to_target, evaluation_edge, ideal_fold
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.fold_plan.plan import plan_folds
from foldcell.skills.garments.garment import Garment
from foldcell.skills.trajectory.arcs.bezier import arc_controls
from foldcell.skills.trajectory.arcs.frame import frames_of
from foldcell.skills.trajectory.arcs.paths import LIFT_HEIGHT, fold_paths, lifted
from foldcell.skills.vocabulary import FoldStep, GraspId, Material

Controls = Mapping[GraspId, Array]

PERTURBED, SHIFT = 6, 0.0005
"""Number of perturbed arcs per evaluation, and maximum shift of each coordinate of their inner control
points [m]."""
NEIGHBOURS = (0.95, 1.0, 1.05)
"""Edge lengths of the three evaluation meshes, relative to `evaluation_edge`. Several meshes are needed, because
the mesh can decide which of two arcs is better. Example, a large shirt's hem: D of the plain arc and of the
initial arc are 6.3 and 5.6 mm on one mesh, 5.5 and 5.6 mm on the second, 5.6 and 5.7 mm on the third."""


@dataclass(frozen=True, eq=False)
class Case:
    """One step of one garment, ready to be folded. coarse: the optimiser's mesh and its vertices (n, 3) before the
    step. fine: the same for each of the evaluation meshes. d_relax: median of D_relax over the fine meshes [m]."""

    garment: Garment
    step: FoldStep
    coarse: tuple[ClothMesh, Array]
    fine: tuple[tuple[ClothMesh, Array], ...]
    d_relax: float

    @property
    def name(self) -> str:
        return f"{self.garment.name}/{self.step.name}"


def prepare(garment: Garment, index: int, scale: float = 1.0, material: Material | None = None) -> Case:
    """Prepare the `index`-th step of a garment in the middle of its pose range. scale: factor on its size.
    material: fabric in place of the garment's own."""
    plan = tuple(replace(step, tension=(0.0, 0.0)) for step in garment.plan)
    garment = replace(garment, plan=plan, material=material or garment.material)
    state = garment.flat_state(*garment.poses.middle, scale=scale)
    step = plan_folds(state, garment).unwrap()[index]
    edge = evaluation_edge(garment, scale)
    finer = [mesh_from_contour(state.contour, share * edge, garment.layers) for share in NEIGHBOURS]
    optimised = mesh_from_contour(state.contour, garment.mesh_edge_m * scale, garment.layers)
    with ThreadPoolExecutor(2) as pool:
        relaxed = list(pool.map(lambda mesh: d_relax(mesh, step.lines, garment.material)[0], finer))
        meshes = (optimised, *finer)
        before = list(pool.map(lambda mesh: ideal_fold(mesh, step.earlier, garment.material), meshes))
    coarse, *fine = zip(meshes, before, strict=True)
    return Case(garment, step, coarse, tuple(fine), float(np.median(relaxed)))


def judge(case: Case, controls: Controls, duration: float, pool: ThreadPoolExecutor, n: int = PERTURBED) -> float:
    """Evaluate arcs: the median of D [m] over n arcs whose inner control points are moved slightly and randomly,
    on the fine meshes in turn."""
    rng = np.random.default_rng(0)
    moved = []
    for _ in range(n):
        arcs = {i: np.array(c) for i, c in sorted(controls.items())}
        for arc in arcs.values():
            arc[1:-1] += rng.uniform(-SHIFT, SHIFT, arc[1:-1].shape)
        moved.append(arcs)
    meshes = (case.fine * n)[:n]
    return float(np.median(list(pool.map(partial(_miss, case, duration), meshes, moved))))


def _miss(case: Case, duration: float, on: tuple[ClothMesh, Array], controls: Controls) -> float:
    mesh, before = on
    headings = {i: grasp.heading for i, grasp in case.step.grasps.items()}
    arcs = fold_paths(controls, headings, duration)
    executed = {i: lifted(path, LIFT_HEIGHT) for i, path in arcs.items()}
    after = predict_fold(mesh, before, case.garment.material, executed).vertices
    return distance_to_target(mesh, case.step.lines, case.garment.material, after)


def initial(case: Case) -> dict[GraspId, Array]:
    frames = frames_of(case.step, case.garment.material.thickness)
    return {i: arc_controls(frame.start, frame.end) for i, frame in frames.items()}
