"""Folds: how fast, how clean, how smooth."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from benchmarks.cloth.scenes import (
    MATERIAL,
    SHIRT,
    most_crossings,
    planned_folds,
    shirt_folds,
    shortened,
    timed,
    towel_half,
    towel_mesh,
    towel_quarter,
)
from skills.cloth.crossings import count_crossings
from skills.cloth.mesh import mesh_from_contour
from skills.cloth.predict import predict_fold
from skills.cloth.solver import ClothSimulation

Figures = dict[str, Any]
SIZES = (425, 1300, 5200, 20000)


def towel(figures: Figures) -> None:
    mesh, material = towel_mesh(425)
    flat = mesh.lay_flat(material.thickness)
    timed(mesh, flat, material, towel_half())  # compiles
    one, speed = timed(mesh, flat, material, towel_half())
    figures["towel_vertices"] = len(mesh.rest)
    figures["towel_425_x_realtime"] = speed
    target = flat.copy()
    over = flat[:, 0] > 0
    target[over, 0] *= -1
    target[over, 2] += material.thickness
    figures["towel_mean_error_mm"] = 1e3 * float(np.linalg.norm(one.vertices - target, axis=1).mean())
    two, speed = timed(mesh, one.vertices, material, towel_quarter())
    figures["towel_425_second_fold_x_realtime"] = speed
    figures["towel_end_crossings"] = sum(count_crossings(r.vertices, mesh.triangles) for r in (one, two))
    figures["towel_residual_mm_max"] = 1e3 * max(one.residual_motion, two.residual_motion)
    again, _ = timed(mesh, flat, material, towel_half())
    figures["towel_same_bits_again"] = again.vertices.tobytes() == one.vertices.tobytes()
    noise = np.random.default_rng(1).normal(scale=1e-6, size=flat.shape)
    jittered, _ = timed(mesh, flat + noise, material, towel_half())
    figures["towel_1e-6_m_grows_to_mm_mean"] = 1e3 * float(
        np.linalg.norm(jittered.vertices - one.vertices, axis=1).mean()
    )


def sizes(figures: Figures, quick: bool) -> None:
    """The 5200-vertex fold, and what the first second of the fold costs over the number of vertices (CPU seconds;
    about linear is an exponent of about one)."""
    if not quick:
        mesh, material = towel_mesh(5200)
        figures["towel_5200_x_realtime"] = timed(mesh, mesh.lay_flat(material.thickness), material, towel_half())[
            1
        ]
    else:
        figures["towel_5200_x_realtime"] = None
    counts, seconds = [], []
    for n in SIZES[: 2 if quick else None]:
        mesh, material = towel_mesh(n)
        paths = {side: shortened(path, 1.0) for side, path in towel_half().items()}
        start = time.thread_time()
        predict_fold(mesh, mesh.lay_flat(material.thickness), material, paths, 0.0, 0.1)
        counts.append(len(mesh.rest))
        seconds.append(time.thread_time() - start)
    figures["cost_vertices"], figures["cost_cpu_s"] = counts, seconds
    figures["cost_exponent"] = float(np.polyfit(np.log(counts), np.log(seconds), 1)[0])


def threads(figures: Figures) -> None:
    """Two simulations in two threads against one after the other (wall time, best of three)."""
    mesh, material = towel_mesh(1300)
    flat = mesh.lay_flat(material.thickness)

    def work(_: int) -> None:
        timed(mesh, flat, material, towel_half())

    def wall(workers: int) -> float:
        start = time.perf_counter()
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, range(2)))
        return time.perf_counter() - start

    figures["two_threads_x_throughput"] = max(wall(1) / wall(2) for _ in range(3))


def shirt(figures: Figures) -> None:
    mesh = mesh_from_contour(SHIRT, 0.0255, layers=2)
    rest = ClothSimulation(mesh, MATERIAL)
    rest.advance(60)
    start = time.thread_time()
    rest.advance(60)
    figures["shirt_vertices"] = len(mesh.rest)
    figures["shirt_1307_rest_x_realtime"] = 1.0 / (time.thread_time() - start)
    x, ends, worst, speeds, residual = rest.positions, [], [], [], 0.0
    for paths in shirt_folds():
        result, speed = timed(mesh, x, MATERIAL, paths)
        most, _ = most_crossings(mesh, x, MATERIAL, paths)
        x = result.vertices
        speeds.append(speed)
        worst.append(most)
        ends.append(count_crossings(x, mesh.triangles))
        residual = max(residual, result.residual_motion)
    figures["shirt_1307_sleeve_x_realtime"] = min(speeds[:2])
    figures["shirt_1307_hem_x_realtime"] = speeds[2]
    figures["shirt_end_crossings"] = max(ends)
    figures["shirt_max_crossings"] = max(worst)
    figures["shirt_residual_mm_max"] = 1e3 * residual


def pants(figures: Figures) -> None:
    mesh, material, folds = planned_folds("pants")
    x, ends, worst = mesh.lay_flat(material.thickness), [], 0
    for paths in folds:
        most, x = most_crossings(mesh, x, material, paths)
        worst = max(worst, most)
        ends.append(count_crossings(x, mesh.triangles))
    figures["pants_end_crossings"], figures["pants_max_crossings"] = max(ends), worst


def measure(figures: Figures, quick: bool, tell: Callable[[str], None]) -> None:
    for name, part in (
        ("towel", towel),
        ("towels of 400 to 20 000 vertices", lambda f: sizes(f, quick)),
        ("two threads", threads),
        ("shirt", shirt),
        ("pants", pants),
    ):
        tell(f"{name} ...")
        part(figures)
