"""Makes a fold without grippers: the moving part turns over about the fold line, like the page of a book.

Cloth that lies flat before and after the fold, away from creases, is guided: it turns rigidly about the line by
half a turn. It ends exactly where the fold's isometry maps it, at the height of its layer. The rest of the cloth
moves freely, with contacts: the strip at the line, and cloth that bulges or lies on a bulge. Creases can therefore
open to loops, no layer passes through another, and no strain remains that could throw the cloth about when it is
released.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from foldcell.skills.cloth.intersections.crossings import count_crossings
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.fold_plan.folding import fold_xy, target_vertices
from foldcell.skills.vocabulary import Array, FoldLine, Material

TURN_S, HOLD_S = 1.2, 0.2
"""Duration of the half turn, which starts and ends gently, and time for which the guided cloth is then
held [s]."""
UNTANGLING_S = 1.0
"""Maximum simulated time for resolving the remaining crossings [s]."""
LOOP = 3.0
"""Half the width of the strip at the line that moves freely, in bending lengths. The loop of a crease is 1.5
bending lengths high. Results with values from 2 to 5 differ less than results on different meshes."""
FLAT, CLEARANCE = 0.002, 0.02
"""Cloth counts as flat if its height differs from that of its layer by less than FLAT [m]. A point is guided only
if it is further than CLEARANCE from cloth that is not flat [m]."""
ESCORTED = 0.8
"""Share of the turn up to which earlier creases in the moving part are turned with it. Limp cloth that moved
freely from the start would fall back over the crease. After this share of the turn, the cloth falls on to its
place."""
KEPT = 0.9
"""Share of its velocity that the free cloth retains from one frame to the next, which damps its motion."""


def turned_over(
    mesh: ClothMesh,
    lines: tuple[FoldLine, ...],
    material: Material,
    before: Array,
    settings: SolverSettings | None = None,
    go_on: Callable[[], None] = lambda: None,
    turn_s: float = TURN_S,
) -> Array:
    """Make the fold about the last of `lines`. Return the vertices (n, 3). before: (n, 3) vertices after the
    earlier folds. go_on: called in each frame; it may raise an exception to end the computation. turn_s: duration
    of the half turn [s]."""
    settings = settings or SolverSettings()
    ideal = target_vertices(mesh, lines[:-1], material)
    goal = target_vertices(mesh, lines, material)
    distance = lines[-1].signed_distance(fold_xy(lines[:-1], mesh.rest))
    loop = LOOP * material.bending_length
    guided = _guided(before, ideal, goal, distance, loop)
    path = _Page(lines[-1], before[guided], ideal[guided], goal[guided], distance[guided] > 0)
    turns_with = np.setdiff1d(np.flatnonzero(_away(distance, loop) & (distance > 0.0)), guided)
    escort = _Page(
        lines[-1], before[turns_with], ideal[turns_with], goal[turns_with], np.ones(len(turns_with), bool)
    )

    simulation = ClothSimulation(mesh, material, before, settings)
    turning, holding = (round(s * settings.frame_rate) for s in (turn_s, HOLD_S))
    for share in [*(np.arange(1, turning + 1) / turning), *np.ones(holding)]:
        go_on()
        x, v = simulation.positions, KEPT * simulation.velocities
        eased = share * share * (3.0 - 2.0 * share)
        v[guided] = (path.at(eased) - x[guided]) / settings.frame
        if eased < ESCORTED:
            v[turns_with] = (escort.about(np.pi * eased) - x[turns_with]) / settings.frame
        simulation.set_positions(x, v)
        simulation.advance()
    return _untangled(mesh, material, simulation.positions, guided, settings, go_on)


def _untangled(
    mesh: ClothMesh,
    material: Material,
    x: Array,
    guided: NDArray[np.int64],
    settings: SolverSettings,
    go_on: Callable[[], None],
) -> Array:
    """Resolve the crossings of x (n, 3) in at most UNTANGLING_S, while the guided points stay in place. Return the
    vertices (n, 3).

    This needs one continuous simulation. The loop of `turned_over` sets the positions anew in each frame, so the
    solver there forgets how long cloth has been crossing, and does not resolve the crossing.
    """
    if not count_crossings(x, mesh.triangles):
        return x
    fixed = np.zeros(len(x), dtype=bool)
    fixed[guided] = True
    simulation = ClothSimulation(mesh, material, x, settings, fixed=fixed)
    for _ in range(round(UNTANGLING_S * settings.frame_rate)):
        go_on()
        simulation.advance()
        if not count_crossings(simulation.positions, mesh.triangles):
            break
    return simulation.positions


def _guided(before: Array, ideal: Array, goal: Array, distance: Array, loop: float) -> NDArray[np.int64]:
    """Select the vertices to be guided (indices): those that lie flat, away from the line, and will lie neither on
    nor beneath a bulge after the fold."""
    away = _away(distance, loop)
    flat = np.abs(before[:, 2] - ideal[:, 2]) < FLAT
    if not flat.all():
        to_bulge, _ = cKDTree(goal[~flat, :2]).query(goal[:, :2])
        away &= to_bulge > CLEARANCE
    return np.flatnonzero(away & flat)


def _away(distance: Array, loop: float) -> NDArray[np.bool_]:
    """Whether points at these distances from the line are outside the strip that moves freely."""
    return np.asarray(np.abs(distance) > min(loop, 0.5 * float(distance.max())))


class _Page:
    """Computes the positions of the g guided points during the fold. Those marked in `turned` move half a turn
    about the line, the others stay."""

    def __init__(
        self, line: FoldLine, before: Array, ideal: Array, goal: Array, turned: NDArray[np.bool_]
    ) -> None:
        self._before, self._turned, self._normal = before, turned[:, None], line.normal
        self._out = line.signed_distance(before[:, :2])
        self._axis = 0.5 * (ideal[:, 2] + goal[:, 2])
        self._left = goal - np.where(self._turned, self.about(np.pi), before)

    def at(self, share: float) -> Array:
        """Return the positions (g, 3) at a share (0..1) of the turn. The initial deviation from the ideal shape is
        removed gradually."""
        return np.where(self._turned, self.about(np.pi * share), self._before) + share * self._left

    def about(self, angle: float) -> Array:
        """Turn all points by `angle` [rad] about the line: (g, 3). The height of a point's axis is midway between
        the heights of its layer before and after the fold."""
        up = self._before[:, 2] - self._axis
        out = self._out * np.cos(angle) - up * np.sin(angle)
        height = self._axis + up * np.cos(angle) + self._out * np.sin(angle)
        return np.column_stack([self._before[:, :2] + (out - self._out)[:, None] * self._normal, height])
