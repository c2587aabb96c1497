"""Simulates the ideal folds of a garment; no grippers take part. In each fold, the moving part is turned over
about the fold line, and then the cloth settles.

The caller supplies the cloth: the simulated cell its own garment, a predictor its mesh and the nominal fabric.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foldcell.skills.cloth.intersections.crossings import count_crossings
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.cloth.strain import largest_strain
from foldcell.skills.fold_plan.turned_fold import TURN_S, turned_over
from foldcell.skills.vocabulary import Array, FoldLine, Material, frozen

REST_MOTION = 5e-4
"""Cloth whose vertices move less than this in REST_S counts as settled [m]."""
REST_S = 0.1
SETTLE_S = 10.0
"""Default time for settling after each fold [s]."""
MORE_S = 6.0
"""Maximum additional time for a fold that still moves after its time for settling [s]."""


@dataclass(frozen=True, eq=False)
class IdealFold:
    """The garment after an ideal fold has settled. vertices: (n, 3) [m]; motion: largest displacement of a vertex
    in the last REST_S [m]; crossings: number of places where an edge passes through a triangle; strain: largest
    elongation or compression of an edge away from creases, as a fraction. rest_s: time after which the whole
    garment slept [s], infinite if it did not. A longer time for settling does not change a garment that sleeps."""

    vertices: Array
    motion: float
    crossings: int
    strain: float
    rest_s: float = math.inf


def ideal_folds(
    mesh: ClothMesh,
    lines: Sequence[FoldLine],
    material: Material,
    settings: SolverSettings | None = None,
    settle_s: float | Sequence[float] = SETTLE_S,
    go_on: Callable[[], None] = lambda: None,
    turn_s: float = TURN_S,
) -> tuple[IdealFold, ...]:
    """Make the folds about `lines` in order, starting from the flat garment. Return the garment after each fold.

    lines: in the coordinates of the mesh's rest shape [m]. settle_s: time for settling after each fold, or one
    time for all [s]; a fold that still moves then settles for at most MORE_S longer. go_on: called often; it may
    raise an exception to end the computation. turn_s: duration of each half turn [s]. Raises ConfigurationError
    for a material that cannot be simulated, InternalError if the simulation becomes unstable.
    """
    settings = settings or SolverSettings()
    times = [settle_s] * len(lines) if isinstance(settle_s, int | float) else list(settle_s)
    folds: list[IdealFold] = []
    for k in range(len(lines)):
        before = folds[-1].vertices if folds else mesh.lay_flat(material.thickness)
        turned = turned_over(mesh, tuple(lines[: k + 1]), material, before, settings, go_on, turn_s)
        folds.append(settled_fold(mesh, material, turned, settings, times[k], go_on))
    return tuple(folds)


def settled_fold(
    mesh: ClothMesh,
    material: Material,
    turned: Array,
    settings: SolverSettings,
    settle_s: float = SETTLE_S,
    go_on: Callable[[], None] = lambda: None,
) -> IdealFold:
    """Let a garment settle after its last fold was turned over, and measure it. turned: (n, 3) its vertices after
    the turn [m]."""
    simulation = ClothSimulation(mesh, material, turned, settings)
    frames = max(1, round(REST_S * settings.frame_rate))
    rounds, most = max(1, round(settle_s / REST_S)), round((settle_s + MORE_S) / REST_S)
    done, motion = 0, math.inf
    while done < rounds or (motion >= REST_MOTION and done < most):
        go_on()
        before = simulation.positions
        simulation.advance(frames)
        done += 1
        motion = float(np.linalg.norm(simulation.positions - before, axis=1).max())
        if simulation.asleep.all():
            break
    x = simulation.positions
    rest_s = simulation.time if simulation.asleep.all() else math.inf
    return IdealFold(frozen(x), motion, count_crossings(x, mesh.triangles), largest_strain(mesh, x), rest_s)
