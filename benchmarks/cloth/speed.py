"""Measures the speed of the solver: simulated seconds over CPU seconds of one thread."""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import TIMES, mirrored, shortened, timed, towel_half, towel_mesh, towel_quarter
from foldcell.robots.errors import InternalError
from foldcell.skills.cloth.intersections.crossings import count_crossings
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.cloth.solver import ClothSimulation

SIZES = (425, 1300, 5200, 20000)


def towel(quick: bool, tell: Tell) -> dict[str, Any]:
    mesh, material = towel_mesh(425)
    flat = mesh.lay_flat(material.thickness)
    timed(mesh, flat, material, towel_half())  # compiles the solver
    one, speed = timed(mesh, flat, material, towel_half(), times=TIMES)
    two, second = timed(mesh, one.vertices, material, towel_quarter(), times=TIMES)
    return {
        "towel_vertices": len(mesh.rest),
        "towel_425_x_realtime": speed,
        "towel_425_second_fold_x_realtime": second,
        "towel_mean_error_mm": 1e3 * mirrored(mesh, material, one.vertices),
        "towel_end_crossings": sum(count_crossings(r.vertices, mesh.triangles) for r in (one, two)),
        "towel_residual_mm_max": 1e3 * max(one.residual_motion, two.residual_motion),
    }


def sizes(quick: bool, tell: Tell) -> dict[str, Any]:
    """Measure the speed of the fold with 5200 vertices, and the CPU time of a fold's first second for several
    numbers of vertices.

    cost_exponent: the CPU time grows with this power of the number of vertices; 1 means that it grows linearly.
    cost_lost_vertices: the numbers of vertices with which the simulation diverged.
    """
    counts, seconds, lost = [], [], []
    paths = {side: shortened(path, 1.0) for side, path in towel_half().items()}
    for n in (SIZES[0], *SIZES[: 2 if quick else None]):  # the first one compiles the solver
        mesh, material = towel_mesh(n)
        start = time.thread_time()
        try:
            predict_fold(mesh, mesh.lay_flat(material.thickness), material, paths, 0.0, 0.1)
        except InternalError:  # a failure is reported as a figure, and the other sizes are still measured
            lost.append(len(mesh.rest))
            continue
        counts.append(len(mesh.rest))
        seconds.append(time.thread_time() - start)
        tell(f"{counts[-1]} vertices: {seconds[-1]:.1f} s of CPU")
    counts, seconds, speed = counts[1:], seconds[1:], None
    if not quick:
        mesh, material = towel_mesh(5200)
        ClothSimulation(mesh, material)  # builds the mesh's clusters, which happens once per mesh
        speed = timed(mesh, mesh.lay_flat(material.thickness), material, towel_half(), times=TIMES)[1]
    return {
        "towel_5200_x_realtime": speed,
        "cost_vertices": counts,
        "cost_cpu_s": seconds,
        "cost_lost_vertices": lost,
        "cost_sizes_lost": len(lost),
        "cost_exponent": float(np.polyfit(np.log(counts), np.log(seconds), 1)[0]),
    }


def threads(quick: bool, tell: Tell) -> dict[str, Any]:
    """Measure the throughput of two simulations in two threads, relative to two simulations one after the other.

    The figure is the ratio of the shortest wall times, each of eight measurements. The largest of eight ratios
    would be too high, because it would come from a measurement in which other work slowed down the serial part.
    """
    mesh, material = towel_mesh(1300)
    flat = mesh.lay_flat(material.thickness)

    def work(_: int) -> None:
        timed(mesh, flat, material, towel_half())

    def wall(workers: int) -> float:
        start = time.perf_counter()
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, range(2)))
        return time.perf_counter() - start

    found = [(wall(1), wall(2)) for _ in range(1 if quick else 8)]
    return {"two_threads_x_throughput": min(one for one, _ in found) / min(two for _, two in found)}


FIRST_FOLD = """
import time
start = time.perf_counter()
from benchmarks.cloth.scenes import timed, towel_half, towel_mesh
mesh, material = towel_mesh(425)
timed(mesh, mesh.lay_flat(material.thickness), material, towel_half())
print(time.perf_counter() - start)
"""


def start(quick: bool, tell: Tell) -> dict[str, Any]:
    """Measure the wall time [s] of the first fold in a new interpreter. The compiled solver is cached on disk."""
    found = [
        float(subprocess.run([sys.executable, "-c", FIRST_FOLD], capture_output=True, check=True).stdout)
        for _ in range(2)
    ]
    return {"first_fold_in_a_new_process_s": min(found)}
