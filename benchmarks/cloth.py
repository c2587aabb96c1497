"""Figures of the cloth solver, alone on one core: python -m benchmarks.cloth (JSON, units in the keys)."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np

from robots.ports import Array, Side
from skills.cloth.crossings import count_crossings
from skills.cloth.elastic import GRAVITY
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.predict import FoldPrediction, predict_fold
from skills.cloth.solver import ClothSimulation, SolverSettings
from skills.vocabulary import Material, ToolPath

MATERIAL = Material(0.4, 0.03, 0.02, 0.003, 0.6, 0.55, 0.5)
HALF_SHIRT = [(0.08, 0.30), (0.22, 0.26), (0.60, 0.10), (0.57, 0.01), (0.24, 0.12), (0.24, -0.35)]
RELEASE, SETTLE, DURATION = 0.3, 1.0, 3.0


def arc(start: tuple[float, ...], end: tuple[float, ...], heading: float, lift: float = 0.4) -> ToolPath:
    """The paper's kind of arc: a cubic Bezier, even in arc length, smooth in time."""
    a, b = np.array(start), np.array(end)
    up = np.array([0.0, 0.0, lift * np.linalg.norm((b - a)[:2])])
    p = np.array([a, a + 0.25 * (b - a) + up, a + 0.75 * (b - a) + up, b])
    t, fine = np.linspace(0.0, DURATION, 181), np.linspace(0.0, 1.0, 500)

    def at(u: Array) -> Array:
        return np.stack([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1) @ p

    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at(fine), axis=0), axis=1))])
    q = t / DURATION
    zero = np.zeros(len(t))
    return ToolPath(
        t, at(np.interp(q**3 * (10 - 15 * q + 6 * q * q), s / s[-1], fine)), zero + heading, zero, zero
    )


def fold(mesh: ClothMesh, x: Array, paths: dict[Side, ToolPath]) -> tuple[FoldPrediction, float]:
    """A fold and how many times faster than real time it was computed."""
    start = time.thread_time()
    result = predict_fold(mesh, x, MATERIAL, paths, RELEASE, SETTLE)
    return result, (DURATION + RELEASE + SETTLE) / (time.thread_time() - start)


def towel(figures: dict[str, float]) -> None:
    mesh = mesh_from_contour(np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]), 0.0262)
    flat = mesh.lay_flat(MATERIAL.thickness)
    first = {
        side: arc((0.288, y, 0.001), (-0.288, y, 0.012), np.pi / 2)
        for side, y in ((Side.LEFT, 0.188), (Side.RIGHT, -0.188))
    }
    second = {
        side: arc((x, 0.188, 0.0005), (x, -0.188, 0.02), 0.0)
        for side, x in ((Side.LEFT, -0.268), (Side.RIGHT, -0.06))
    }
    fold(mesh, flat, first)  # compiles
    one, speed = fold(mesh, flat, first)
    figures["towel_vertices"] = len(mesh.rest)
    figures["towel_425_x_realtime"] = speed
    target = flat.copy()
    target[flat[:, 0] > 0, 0] *= -1
    target[flat[:, 0] > 0, 2] += MATERIAL.thickness
    figures["towel_mean_error_mm"] = 1e3 * float(np.linalg.norm(one.vertices - target, axis=1).mean())
    two, speed = fold(mesh, one.vertices, second)
    figures["towel_425_second_fold_x_realtime"] = speed
    figures["towel_end_crossings"] = sum(count_crossings(r.vertices, mesh.triangles) for r in (one, two))
    figures["towel_residual_mm_max"] = 1e3 * max(one.residual_motion, two.residual_motion)


def shirt(figures: dict[str, float]) -> None:
    mesh = mesh_from_contour(np.array(HALF_SHIRT + [(-x, y) for x, y in HALF_SHIRT[::-1]]), 0.0255, layers=2)
    rest = ClothSimulation(mesh, MATERIAL)
    rest.advance(60)
    start = time.thread_time()
    rest.advance(60)
    figures["shirt_vertices"] = len(mesh.rest)
    figures["shirt_1307_rest_x_realtime"] = 1.0 / (time.thread_time() - start)
    q, x, ends, speeds = np.pi / 2, rest.positions, [], []
    for left, right, heading in (  # start and end of each hand: (x, y, z), (x, y, z)
        (((0.57, 0.06, 5e-4), (-0.25, 0.06, 0.02)), ((0.225, -0.33, 5e-4), (0.095, -0.33, 0.02)), q),
        (((-0.57, 0.06, 5e-4), (0.25, 0.06, 0.03)), ((-0.225, -0.33, 5e-4), (-0.095, -0.33, 0.03)), q),
        (((-0.13, -0.335, 5e-4), (-0.13, 0.25, 0.035)), ((0.13, -0.335, 5e-4), (0.13, 0.25, 0.035)), 0.0),
    ):
        paths = {Side.LEFT: arc(*left, heading), Side.RIGHT: arc(*right, heading)}
        result, speed = fold(mesh, x, paths)
        x = result.vertices
        speeds.append(speed)
        ends.append(count_crossings(x, mesh.triangles))
    figures["shirt_1307_sleeve_x_realtime"] = min(speeds[:2])
    figures["shirt_1307_hem_x_realtime"] = speeds[2]
    figures["shirt_sleeves_end_crossings"] = ends[1]
    figures["shirt_end_crossings"] = ends[2]


def tilt(figures: dict[str, float]) -> None:
    mesh = mesh_from_contour(np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]]), 0.026)
    creep, error = 0.0, 0.0
    for mu in (0.2, 0.6, 1.0):
        for ratio in (0.98, 1.02, 1.1, 1.5):
            a = np.arctan(ratio * mu)
            settings = SolverSettings(gravity=(GRAVITY * np.sin(a), 0.0, -GRAVITY * np.cos(a)), drag=0.0)
            s = ClothSimulation(
                mesh, replace(MATERIAL, friction_static=mu, friction_dynamic=mu), settings=settings
            )
            before = s.positions
            s.advance(60)
            way = float((s.positions - before)[:, 0].mean())
            if ratio < 1.0:
                creep = max(creep, 1e3 * abs(way))
            else:
                error = max(error, abs(way / (0.5 * GRAVITY * (np.sin(a) - mu * np.cos(a))) - 1.0))
    figures["tilt_creep_mm_max"], figures["tilt_slide_error_rel_max"] = creep, error


def hang(figures: dict[str, float], length: float = 0.6, width: float = 0.15) -> None:
    worst = 0.0
    for edge in (0.018, 0.026, 0.03):
        mesh = mesh_from_contour(np.array([[0, 0], [width, 0], [width, length], [0, length]]), edge)
        top, bottom = mesh.rest[:, 1] > length - 1e-9, mesh.rest[:, 1] < 1e-9
        x = np.column_stack([mesh.rest[:, 0], np.zeros(len(mesh.rest)), mesh.rest[:, 1]])
        for stretch in (0.01, 0.02, 0.035):
            material = replace(MATERIAL, stretch_fraction=stretch)
            settings = SolverSettings(drag=2.0, sleep_frames=0)
            s = ClothSimulation(mesh, material, x, settings, table=False, fixed=top)
            s.advance(200)
            z = s.positions[:, 2]
            worst = max(worst, abs((z[top].mean() - z[bottom].mean()) / length - 1.0 - stretch))
    figures["hang_error_pp_max"] = 100.0 * worst


def main() -> None:
    figures: dict[str, float] = {}
    for part in (towel, shirt, tilt, hang):
        part(figures)
    print(json.dumps({k: round(float(v), 4) for k, v in figures.items()}))


if __name__ == "__main__":
    main()
