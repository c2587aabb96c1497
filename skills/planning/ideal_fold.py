"""Makes the ideal folds of a garment without grippers: each fold is turned over and then settles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skills.cloth.intersections.crossings import count_crossings
from skills.cloth.mesh import ClothMesh
from skills.cloth.settings import SolverSettings
from skills.cloth.solver import ClothSimulation
from skills.cloth.strain import largest_strain
from skills.planning.turned_fold import TURN_S, turned_over
from skills.vocabulary import Array, FoldLine, Material, frozen

__all__ = ["IdealFold", "ideal_fold", "ideal_folds", "settled"]

REST_MOTION = 5e-4
"""Cloth whose vertices move less than this in REST_S counts as settled [m]."""
REST_S = 0.1
MOST_SETTLING_S = 6.0
"""Maximum simulated time for settling after a fold [s]."""


@dataclass(frozen=True, eq=False)
class IdealFold:
    """The garment after an ideal fold has settled. vertices: (n, 3) [m]; motion: largest displacement of a vertex
    in the last REST_S [m]; crossings: number of pairs of triangles that pass through each other; strain: largest
    elongation of an edge away from creases, as a fraction."""

    vertices: Array
    motion: float
    crossings: int
    strain: float


def ideal_folds(
    mesh: ClothMesh,
    lines: Sequence[FoldLine],
    material: Material,
    settings: SolverSettings | None = None,
    settle_s: float = 1.0,
    go_on: Callable[[], None] = lambda: None,
    turn_s: float = TURN_S,
) -> tuple[IdealFold, ...]:
    """Make the folds about `lines` in order, starting from the flat garment. After each fold, the garment settles
    for at least `settle_s` [s], and then until it rests. Returns the garment after each fold. go_on: called often;
    it may raise an exception to end the computation. turn_s: duration of each half turn [s]."""
    settings = settings or SolverSettings()
    x, found = mesh.lay_flat(material.thickness), []
    for k in range(len(lines)):
        turned = turned_over(mesh, tuple(lines[: k + 1]), material, x, settings, go_on, turn_s)
        fold = ideal_fold(mesh, material, turned, settings, settle_s, go_on)
        x = fold.vertices
        found.append(fold)
    return tuple(found)


def ideal_fold(
    mesh: ClothMesh,
    material: Material,
    turned: Array,
    settings: SolverSettings,
    settle_s: float,
    go_on: Callable[[], None] = lambda: None,
) -> IdealFold:
    """Let a garment settle whose last fold was just turned over, from `turned` (n, 3), and measure it."""
    simulation = ClothSimulation(mesh, material, turned, settings)
    tail = round(REST_S * settings.frame_rate)
    for _ in range(max(0, round(settle_s / REST_S) - 1)):
        go_on()
        simulation.advance(tail)
    while True:
        go_on()
        before = simulation.positions
        simulation.advance(tail)
        x = simulation.positions
        motion = float(np.linalg.norm(x - before, axis=1).max())
        if motion < REST_MOTION or simulation.time >= MOST_SETTLING_S:
            break
    return IdealFold(frozen(x), motion, count_crossings(x, mesh.triangles), largest_strain(mesh, x))


def settled(mesh: ClothMesh, material: Material, start: Array, settings: SolverSettings, settle_s: float) -> Array:
    """Simulate `settle_s` [s] from `start` (n, 3), without grippers. Return the vertices (n, 3)."""
    simulation = ClothSimulation(mesh, material, start, settings)
    simulation.advance(frames=round(settle_s * settings.frame_rate))
    return simulation.positions
