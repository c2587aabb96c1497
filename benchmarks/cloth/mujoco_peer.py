"""Compares the cloth solver with an independent simulation, MuJoCo's flex. It needs the optional extra `peers`,
which no run needs.

The model is that of the cell's second simulated world (`cell/simulation/garment/mujoco_cloth.py`), with our
meshes, pads and materials. Its time step and contact stiffness are not chosen by comparison with our result, but
by refinement: time step and contact time are halved until the end of the fold stops changing.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.physics import FRICTIONS, STRETCHES, STRIP, on_slopes
from benchmarks.cloth.scenes import MATERIAL, RELEASE, SETTLE, SharedFold, optimised_fold, plain_fold
from foldcell.calibration.bending import peirce
from foldcell.cell.simulation.garment.mujoco_cloth import MujocoCloth, MujocoSettings
from foldcell.robots.ports import Array
from foldcell.skills.cloth.elasticity import GRAVITY
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold, sample_paths
from foldcell.skills.vocabulary import Material

Figures = dict[str, Any]
LAB = MujocoSettings(steps=8, solref=0.005, iterations=50, rest=False, selfcollide=False)
USED = 8
REFINEMENTS = (4, USED, 2 * USED)
"""Numbers of time steps per frame in the refinement. The contacts' time constant is 2.4 steps. The comparison of
folds uses USED steps."""
SETTLED = 0.5
"""The refinement has converged if its last halving moves the vertices at the end of the fold by less than this, on
average [mm]."""


def refined(steps: int) -> MujocoSettings:
    step = MujocoSettings(steps=steps).step
    return MujocoSettings(steps=steps, solref=2.4 * step, iterations=100, tolerance=1e-10, rest=False)


def tilt(figures: Figures, frictions: Sequence[float] = FRICTIONS) -> None:
    def cloth(mesh: ClothMesh, material: Material, gravity: tuple[float, float, float]) -> MujocoCloth:
        return MujocoCloth(mesh, material, settings=replace(LAB, gravity=gravity))

    creep, error = on_slopes(cloth, frictions)
    figures["mujoco_tilt_creep_mm_max"], figures["mujoco_tilt_slide_error_rel_max"] = creep, error


def hang(
    figures: Figures, stretches: Sequence[float] = STRETCHES, edges: Sequence[float] = (0.018, 0.026)
) -> None:
    """Measure the error of the elongation of strips that hang in their own plane, and add it to `figures`."""
    width, length = STRIP
    worst = 0.0
    for edge in edges:
        mesh = mesh_from_contour(np.array([[0, 0], [width, 0], [width, length], [0, length]]), edge)
        top, bottom = mesh.rest[:, 1] > length - 1e-9, mesh.rest[:, 1] < 1e-9
        settings = replace(LAB, gravity=(0.0, -GRAVITY, 0.0), damping=0.01)
        for stretch in stretches:
            material = replace(MATERIAL, stretch_fraction=stretch)
            fixed = np.flatnonzero(top).tolist()
            cloth = MujocoCloth(mesh, material, settings=settings, table=False, fixed=fixed)
            cloth.advance(180)
            worst = max(worst, abs(-float(cloth.positions[bottom, 1].mean()) / length - stretch))
    figures["mujoco_hang_error_pp_max"] = 100.0 * worst


def bending(figures: Figures, edge: float = 0.020) -> None:
    """Perform Peirce's cantilever test with a strip whose overhang is twice its bending length, and add the error
    of the bending length to `figures`."""
    material = replace(MATERIAL, bending_length=0.08)
    overhang = 2.0 * material.bending_length
    outline = [(-2 * edge, 0.0), (0.0, 0.0), (overhang, 0.0)]
    mesh = mesh_from_contour(np.array(outline + [(x, 4 * edge) for x, _ in outline[::-1]]), edge)
    fixed = np.flatnonzero(mesh.rest[:, 0] < 1e-6).tolist()
    cloth = MujocoCloth(mesh, material, settings=replace(LAB, damping=0.05), table=False, fixed=fixed)
    height = float(cloth.positions[0, 2])
    cloth.advance(360)
    tip = cloth.positions[mesh.rest[:, 0] > overhang - 1e-6].mean(axis=0)
    angle = float(np.arctan2(height - tip[2], tip[0]))
    figures["mujoco_bending_error_rel"] = peirce(overhang, angle) / material.bending_length - 1.0


def folded(fold: SharedFold, settings: MujocoSettings) -> tuple[Array, float]:
    """Make the fold in MuJoCo. Return the vertices (n, 3) at its end, and the speed of one thread relative to real
    time."""
    cloth = MujocoCloth(fold.mesh, fold.material, fold.start, settings)
    start = time.thread_time()
    frames = round((fold.seconds - RELEASE - SETTLE) * settings.frame_rate)
    position, rotation = sample_paths(fold.paths, frames, 1.0 / settings.frame_rate)
    for hand in range(2):
        cloth.grip(hand, position[0, hand], rotation[0, hand])
    cloth.advance_along(position, rotation)
    for hand in range(2):
        cloth.release(hand)
    cloth.advance(round((RELEASE + SETTLE) * settings.frame_rate))
    return cloth.positions, fold.seconds / (time.thread_time() - start)


def apart(a: Array, b: Array) -> float:
    """Mean distance [mm] between two sets of vertices (n, 3)."""
    return 1e3 * float(np.linalg.norm(a - b, axis=1).mean())


def refinement(quick: bool, tell: Tell) -> Figures:
    """Refine MuJoCo's simulation: measure how the end of the fold changes when time step and contact time are
    halved.

    The refinement has converged if the last halving changes the end by less than SETTLED. The comparison of folds
    uses the settings before this halving.
    """
    fold, rows, before = plain_fold(), [], None
    for steps in REFINEMENTS[:2] if quick else REFINEMENTS:
        end, speed = folded(fold, refined(steps))
        rows.append({
            "steps_a_frame": steps, "contact_time_ms": 1e3 * refined(steps).solref, "x_realtime": speed,
            "change_mm": None if before is None else apart(end, before), "error_mm": 1e3 * fold.error(end),
        })  # fmt: skip
        before = end
        tell(f"{steps} steps a frame: {1e3 * fold.error(end):.1f} mm from the ideal fold, {speed:.2f} x real time")
    change = float(rows[-1]["change_mm"])
    return {
        "mujoco_refinement": rows,
        "mujoco_refinement_last_change_mm": change,
        "mujoco_refinement_converged": change < SETTLED,
    }


def folds(quick: bool, tell: Tell) -> Figures:
    """Compare the same folds in both simulations, with the same mesh and the same motion of the pads."""
    figures: Figures = {"mujoco_steps_a_frame": USED}
    settings, rows = refined(USED), []
    for mu in (0.6,) if quick else (0.2, 0.6, 1.0):
        fold = plain_fold(mu)
        ours = predict_fold(fold.mesh, fold.start, fold.material, fold.paths, RELEASE, SETTLE).vertices
        theirs, speed = folded(fold, settings)
        rows.append({
            "friction": mu, "difference_mm": apart(ours, theirs), "error_mm": 1e3 * fold.error(ours),
            "mujoco_error_mm": 1e3 * fold.error(theirs), "drift_mm": _drift(fold, ours),
            "mujoco_drift_mm": _drift(fold, theirs),
        })  # fmt: skip
        tell(f"friction {mu}: {rows[-1]['difference_mm']:.2f} mm apart")
        if mu == MATERIAL.friction_static:
            figures["mujoco_towel_x_realtime"] = speed
            figures["mujoco_towel_shape_difference_mm_mean"] = rows[-1]["difference_mm"]
            figures["towel_one_friction_error_mm"] = rows[-1]["error_mm"]
            figures["mujoco_towel_error_mm"] = rows[-1]["mujoco_error_mm"]
    figures["mujoco_folds"] = rows
    return figures


def optimised(quick: bool, tell: Tell) -> Figures:
    """Compare, in both simulations, the fold along the trajectory that our predictor found."""
    best = optimised_fold()
    ours = predict_fold(best.mesh, best.start, best.material, best.paths, RELEASE, SETTLE).vertices
    theirs, _ = folded(best, refined(USED))
    return {
        "optimised_towel_error_mm": 1e3 * best.error(ours),
        "mujoco_optimised_towel_error_mm": 1e3 * best.error(theirs),
        "mujoco_optimised_shape_difference_mm_mean": apart(ours, theirs),
        "mujoco_final_error_difference_mm": 1e3 * (best.error(theirs) - best.error(ours)),
    }


def _drift(fold: SharedFold, x: Array) -> float:
    """Mean displacement [mm] of the half that should stay at rest, away from the crease."""
    rests = fold.mesh.rest[:, 0] < -0.05
    return 1e3 * float(np.linalg.norm((x - fold.start)[rests], axis=1).mean())


def lab(quick: bool, tell: Tell) -> Figures:
    """Perform the laboratory tests in MuJoCo: tilted table, hanging strip and cantilever."""
    figures: Figures = {"mujoco_version": mujoco.__version__}
    tilt(figures, (0.6,) if quick else FRICTIONS)
    hang(figures)
    bending(figures)
    return figures
