"""Tests the determinism of the simulation, and measures the roughness of a cost that is computed from it."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from benchmarks.cloth import Tell
from benchmarks.cloth.scenes import (
    MATERIAL,
    RELEASE,
    SETTLE,
    Paths,
    mirrored,
    shirt_folds,
    towel_half,
    towel_mesh,
)
from foldcell.robots.ports import Array
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.vocabulary import Material

NOISE = 1e-6
"""Standard deviation of the perturbation of each coordinate of the start [m]."""


def digest() -> str:
    """Simulate a towel fold and a sleeve fold. Return a hash of all bits of the results."""
    mesh, material = towel_mesh(425)
    towel = _end(mesh, mesh.lay_flat(material.thickness), material, towel_half())
    shirt, folds = shirt_folds()
    sleeve = _end(shirt, shirt.lay_flat(MATERIAL.thickness), MATERIAL, folds[0])
    return hashlib.sha256(towel.tobytes() + sleeve.tobytes()).hexdigest()


def determinism(quick: bool, tell: Tell) -> dict[str, Any]:
    here = digest()
    command = "from benchmarks.cloth.smooth import digest; print(digest())"
    there = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    with ThreadPoolExecutor(2) as pool:
        threads = set(pool.map(lambda _: digest(), range(2)))
    return {
        "same_bits_again": digest() == here,
        "same_bits_in_another_process": there.stdout.strip() == here,
        "same_bits_in_two_threads_at_once": threads == {here},
    }


def roughness(quick: bool, tell: Tell) -> dict[str, Any]:
    """Measure how sensitive the result is to the start and to a parameter.

    (1) The start is perturbed by 1e-6 m. The figures are the distance of the vertices at the end, and the standard
    deviation of a cost. (2) The arc's height changes in steps of 0.001 of the fold's distance. The figure is the
    standard deviation of the cost about a fitted parabola.
    """
    samples = 3 if quick else 8
    mesh, material = towel_mesh(425)
    flat = mesh.lay_flat(material.thickness)

    def towel_cost(x: Array) -> float:
        return mirrored(mesh, material, x)

    ends = _jittered(mesh, flat, material, [towel_half()], samples)
    figures = _spread("towel", ends, towel_cost)
    tell(f"{len(ends)} towels from starts that differ by 1e-6 m")
    shirt, folds = shirt_folds()
    lying = shirt.lay_flat(MATERIAL.thickness)
    sleeves = _jittered(shirt, lying, MATERIAL, folds[:2], samples)

    def shirt_cost(x: Array) -> float:
        """Mean distance from the flat shirt [m]. It depends on the fold as strongly as any other cost."""
        return float(np.average(np.linalg.norm(x - lying, axis=1), weights=shirt.vertex_area))

    figures |= _spread("shirt_two_sleeves", sleeves, shirt_cost)
    tell(f"{len(sleeves)} shirts likewise")
    lifts = 0.40 + 1e-3 * np.arange(-3 if quick else -6, 4 if quick else 7)
    costs = [towel_cost(_end(mesh, flat, material, towel_half(lift))) for lift in lifts]
    smooth = np.polyval(np.polyfit(lifts - 0.40, costs, 2), lifts - 0.40)
    figures["towel_cost_roughness_mm"] = 1e3 * float(np.std(np.array(costs) - smooth))
    figures["towel_cost_slope_mm_per_0.01"] = 10.0 * float(np.polyfit(lifts - 0.40, costs, 1)[0])
    return figures


def _end(mesh: ClothMesh, x: Array, material: Material, paths: Paths) -> Array:
    return predict_fold(mesh, x, material, paths, RELEASE, SETTLE).vertices


def _jittered(mesh: ClothMesh, x: Array, material: Material, folds: list[Paths], samples: int) -> list[Array]:
    """Make the folds from x, and `samples` times from a perturbed x. Return the vertices (n, 3) at each end."""
    rng, ends = np.random.default_rng(1), []
    for k in range(samples + 1):
        end = x + (rng.normal(scale=NOISE, size=x.shape) if k else 0.0)
        for paths in folds:
            end = _end(mesh, end, material, paths)
        ends.append(end)
    return ends


def _spread(name: str, ends: list[Array], cost: Any) -> dict[str, Any]:
    apart = [np.linalg.norm(end - ends[0], axis=1) for end in ends[1:]]
    return {
        f"{name}_1e-6_m_grows_to_mm_mean": 1e3 * float(np.mean([a.mean() for a in apart])),
        f"{name}_1e-6_m_grows_to_mm_max": 1e3 * float(max(a.max() for a in apart)),
        f"{name}_cost_mm": 1e3 * cost(ends[0]),
        f"{name}_cost_spread_mm": 1e3 * float(np.std([cost(end) for end in ends])),
    }
