"""Compares simulated laboratory tests with closed forms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import MATERIAL, RELEASE, frames_of, stacked, towel_half, towel_mesh
from foldcell.calibration.bending import cantilever
from foldcell.robots.ports import Array
from foldcell.skills.cloth.elasticity import GRAVITY
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Material

PATCH = np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]])
CREEP_RATIO, SLIDE_RATIOS = 0.98, (1.02, 1.1, 1.5)
FRICTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
EDGES = (0.015, 0.018, 0.022, 0.026, 0.030)
STRETCHES = (0.01, 0.02, 0.035)
STRIP = (0.15, 0.6)


def slope(mu: float, ratio: float) -> tuple[float, tuple[float, float, float]]:
    """Return the angle [rad] of a slope that is `ratio` times as steep as the critical slope of friction mu, and
    the gravity on it in the tilted table's frame [m/s2]."""
    angle = float(np.arctan(ratio * mu))
    return angle, (GRAVITY * float(np.sin(angle)), 0.0, -GRAVITY * float(np.cos(angle)))


def slide_expected(mu: float, angle: float, seconds: float = 1.0) -> float:
    """Distance that a block with friction mu slides down a slope of `angle` [rad] from rest in `seconds` [m]."""
    return float(0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle)) * seconds**2)


def tilt(quick: bool, tell: Tell) -> dict[str, Any]:
    creep, error = on_slopes(
        lambda mesh, material, gravity: ClothSimulation(
            mesh, material, settings=SolverSettings(gravity=gravity, drag=0.0)
        )
    )
    return {"tilt_creep_mm_max": creep, "tilt_slide_error_rel_max": error}


def on_slopes(
    cloth: Callable[[ClothMesh, Material, tuple[float, float, float]], Any],
    frictions: Sequence[float] = FRICTIONS,
) -> tuple[float, float]:
    """Test Coulomb friction on a tilted table. Below the critical slope the sheet must not creep; above it, it
    must slide like a block. cloth: makes the simulation from mesh, fabric and gravity. Returns the largest creep
    [mm] and the largest relative error of a slide."""
    mesh = mesh_from_contour(PATCH, 0.026)
    creep, error = 0.0, 0.0
    for mu in frictions:
        material = replace(MATERIAL, friction_static=mu, friction_dynamic=mu)
        for ratio in (CREEP_RATIO, *SLIDE_RATIOS):
            angle, gravity = slope(mu, ratio)
            s = cloth(mesh, material, gravity)
            before = s.positions
            s.advance(60)
            way = (s.positions - before)[:, 0]
            if ratio < 1.0:
                creep = max(creep, 1e3 * float(np.abs(way).max()))
            else:
                error = max(error, abs(float(way.mean()) / slide_expected(mu, angle) - 1.0))
    return creep, error


def layers(quick: bool, tell: Tell) -> dict[str, Any]:
    """Perform the same test with a sheet on another sheet, which sticks to the table. The measurement starts after
    0.2 s, when the upper sheet has come to lie on the lower one."""
    n, mesh = _sheet_on_a_sheet()
    creep, error = 0.0, 0.0
    for mu in FRICTIONS:
        material = replace(MATERIAL, friction_static=5.0, friction_dynamic=5.0, friction_layers=mu)
        for ratio in (CREEP_RATIO, *SLIDE_RATIOS):
            angle, gravity = slope(mu, ratio)
            s = ClothSimulation(mesh, material, settings=SolverSettings(gravity=gravity, drag=0.0, sleep_frames=0))
            s.advance(12)
            before, speed = s.positions[n:, 0], float(s.velocities[n:, 0].mean())
            if ratio < 1.0:
                s.advance(60)
                creep = max(creep, 1e3 * float(np.abs(s.positions[n:, 0] - before).max()))
                continue
            frames = 24  # short enough for the upper sheet to stay on the lower one
            s.advance(frames)
            t = frames * s.settings.frame
            way = float((s.positions[n:, 0] - before).mean()) - speed * t
            error = max(error, abs(way / slide_expected(mu, angle, t) - 1.0))
    return {"tilt_layers_creep_mm_max": creep, "tilt_layers_slide_error_rel_max": error}


def _sheet_on_a_sheet() -> tuple[int, ClothMesh]:
    """Create a mesh of two sheets that are not joined. Return the number of vertices of the lower one, and the
    mesh."""
    lower = mesh_from_contour(np.array([[-0.2, -0.15], [0.6, -0.15], [0.6, 0.15], [-0.2, 0.15]]), 0.026)
    upper = mesh_from_contour(PATCH * [0.66, 0.7], 0.026, rotate=0.3)
    return len(lower.rest), stacked([lower, upper])


def hang_strip(quick: bool, tell: Tell) -> dict[str, Any]:
    """Test the elongation of strips that hang by their upper edge. The closed form is areal_mass g L / (2 Y)."""
    width, length = STRIP
    worst, substeps = 0.0, 0
    for edge in EDGES:
        mesh = mesh_from_contour(np.array([[0, 0], [width, 0], [width, length], [0, length]]), edge)
        top, bottom = mesh.rest[:, 1] > length - 1e-9, mesh.rest[:, 1] < 1e-9
        x = np.column_stack([mesh.rest[:, 0], np.zeros(len(mesh.rest)), mesh.rest[:, 1]])
        for stretch in STRETCHES:
            s = ClothSimulation(
                mesh, replace(MATERIAL, stretch_fraction=stretch), x, SolverSettings(drag=2.0, sleep_frames=0),
                table=False, fixed=top,
            )  # fmt: skip
            s.advance(200)
            z = s.positions[:, 2]
            worst = max(worst, abs(float(z[top].mean() - z[bottom].mean()) / length - 1.0 - stretch))
            substeps = max(substeps, s.substeps)
    return {"hang_strip_error_pp_max": 100.0 * worst, "hang_strip_substeps_max": substeps}


def bending(quick: bool, tell: Tell) -> dict[str, Any]:
    """Perform Peirce's cantilever test for several bending lengths and meshes."""
    worst = 0.0
    for length in (0.012, 0.020, 0.035):
        for edge in (0.015, 0.020, 0.030):
            test = cantilever(replace(MATERIAL, bending_length=length), edge, pictures=2)
            worst = max(worst, abs(test.error))
    return {"bending_error_rel_max": worst}


def conservation(quick: bool, tell: Tell) -> dict[str, Any]:
    """Test conservation and rest. In free space, a sheet moves fast and randomly for half a second; measured are
    the relative loss of momentum and gain of kinetic energy. On the table, the motion of a resting sheet in 10 s
    is measured."""
    mesh = mesh_from_contour(PATCH, 0.026)
    s = ClothSimulation(
        mesh, MATERIAL, settings=SolverSettings(gravity=(0.0, 0.0, 0.0), drag=0.0, sleep_frames=0), table=False
    )
    v = np.random.default_rng(5).normal(scale=0.5, size=(len(mesh.rest), 3))
    s.set_positions(s.positions, v)
    mass = 1.0 / s._body.w[:, None]
    energy = [float((mass * v**2).sum())]
    for _ in range(30):
        s.advance(1)
        energy.append(float((mass * s.velocities**2).sum()))
    lost = np.linalg.norm((mass * (s.velocities - v)).sum(axis=0)) / (mass * np.abs(v)).sum()
    rest = ClothSimulation(mesh, MATERIAL, settings=SolverSettings(sleep_frames=0))
    before = rest.positions
    rest.advance(600)
    return {
        "momentum_lost_rel": float(lost),
        "kinetic_energy_won_rel_max": max(0.0, max(energy) / energy[0] - 1.0),
        "sheet_at_rest_moves_mm_in_10_s": 1e3 * float(np.abs(rest.positions - before).max()),
    }


def grasp(quick: bool, tell: Tell) -> dict[str, Any]:
    """Test the pinch, by three figures: how far the cloth between the pads moves away from them during a fold; the
    error of a hanging towel's weight as the hand measures it; and the error of the pads' friction at which this
    towel slips out, which should equal its weight."""
    mesh, material = towel_mesh(425)
    follow = 0.0
    paths = towel_half()
    duration = max(float(p.t[-1]) for p in paths.values())
    held = {s: int(np.argmin(np.linalg.norm(mesh.rest - p.position[0, :2], axis=1))) for s, p in paths.items()}
    for k, x in enumerate(frames_of(mesh, mesh.lay_flat(material.thickness), material, paths)):
        t = (k + 1) / SolverSettings().frame_rate
        if t > duration:
            break
        for side, path in paths.items():
            at = np.array([np.interp(t, path.t, path.position[:, c]) for c in range(3)])
            reach = float(np.linalg.norm(mesh.rest[held[side]] - path.position[0, :2]))
            follow = max(follow, float(np.linalg.norm(x[held[side]] - at)) - reach)
    force, slips = _hung(mesh)
    weight = material.areal_mass * float(mesh.area.sum()) * GRAVITY
    return {
        "pinch_strays_mm_max": 1e3 * max(0.0, follow),
        "pinch_weight_error_rel": abs(-float(force[2]) / weight - 1.0),
        "pinch_breakaway_error_rel": abs(slips / weight - 1.0),
    }


def _hung(mesh: ClothMesh) -> tuple[Array, float]:
    """Hang the towel from one hand, then reduce the grip force. Return the force (3,) of the hanging towel on the
    hand [N], and the maximum friction of the pads when it slips out [N]."""
    s = ClothSimulation(mesh, MATERIAL, settings=SolverSettings(drag=3.0, sleep_frames=0))
    turned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    start = np.array([0.288, 0.0, 0.001])
    s.grip(0, start, turned)
    up = start + np.array([0.0, 0.0, 0.9])
    raised = start + np.linspace(0.0, 1.0, 121)[:, None] * (up - start)
    s.advance_along(np.stack([raised, raised], axis=1), np.broadcast_to(turned, (121, 2, 3, 3)))
    s.advance(round((1.7 + RELEASE) * 60))
    force, squeeze = s.pinch_force(0), 20.0
    while s.held(0):
        squeeze *= 0.995
        s.set_grip_force(0, squeeze)
        s.advance(1)
    return force, 2.0 * s.pads.friction * squeeze
