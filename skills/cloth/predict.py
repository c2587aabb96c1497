"""Prediction of a fold: the simulation by which every trajectory is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry, Patch, PinchReport
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import GraspId, Material, ToolPath

HANDS = (GraspId.LEFT, GraspId.RIGHT)
"""Grasps of hand 0 and hand 1 of the simulation."""


@dataclass(frozen=True, eq=False)
class FoldPrediction:
    """Result of a simulated fold. vertices: (n, 3) positions after the fold has settled, table frame [m].
    pinches: the report of each
    hand's pinch. dropped: hands that lost their cloth before the end. residual_motion: largest displacement of a
    vertex over the last 0.1 s [m]. keyframes: (k, n, 3) positions at k times, evenly spaced over the motion."""

    vertices: Array
    pinches: Mapping[GraspId, PinchReport]
    dropped: tuple[GraspId, ...]
    residual_motion: float
    keyframes: Array


def predict_fold(
    mesh: ClothMesh,
    positions: Array,
    material: Material,
    paths: Mapping[GraspId, ToolPath],
    release_s: float = 0.3,
    settle_s: float = 1.0,
    settings: SolverSettings | None = None,
    pads: PadGeometry | None = None,
    keyframes: int = 0,
    grip_force: float = 20.0,
    patches: Mapping[GraspId, Patch] | None = None,
) -> FoldPrediction:
    """Simulate the fold of a garment that lies at rest at `positions` (n, 3), along the tools' paths.

    Each gripper closes at the start of its path and opens at the end; the cloth then has release_s + settle_s [s]
    to come to rest. patches: the only cloth that each hand takes; None: any between its pads. A pure function that
    runs without the global interpreter lock for nearly all of its time.
    """
    simulation = ClothSimulation(mesh, material, positions, settings, pads=pads, at_rest=True)
    frame = simulation.settings.frame
    duration = max(float(path.t[-1]) for path in paths.values())
    frames = max(1, round(duration / frame))
    p, r = sample_paths(paths, frames, frame)
    pinches = {
        grasp_id: simulation.grip(hand, p[0, hand], r[0, hand], grip_force, (patches or {}).get(grasp_id))
        for hand, grasp_id in enumerate(HANDS)
        if grasp_id in paths
    }
    shots = set(np.linspace(0, frames, keyframes, dtype=int).tolist()) if keyframes else set()
    pictures = [simulation.positions] if 0 in shots else []
    done = 0
    while done < frames:
        # a few frames per call, so that a call that loses its positions repeats little
        step = min([6, frames - done, *(k - done for k in shots if k > done)])
        simulation.advance_along(p[done : done + step + 1], r[done : done + step + 1])
        done += step
        if done in shots:
            pictures.append(simulation.positions)
    dropped = tuple(
        s for h, s in enumerate(HANDS) if s in paths and pinches[s].held_points and not simulation.held(h)
    )
    for hand in range(len(HANDS)):
        simulation.release(hand)
    rest = max(1, round((release_s + settle_s) / frame))
    tail = min(rest, round(0.1 / frame))
    simulation.advance(rest - tail)
    before = simulation.positions
    simulation.advance(tail)
    after = simulation.positions
    return FoldPrediction(
        frozen(after),
        pinches,
        dropped,
        float(np.linalg.norm(after - before, axis=1).max()),
        np.array(pictures) if pictures else np.zeros((0, len(after), 3)),
    )


def sample_paths(paths: Mapping[GraspId, ToolPath], frames: int, frame: float) -> tuple[Array, Array]:
    """Return the poses of both hands at the frame boundaries: positions (frames + 1, 2, 3), rotations (frames + 1,
    2, 3, 3)."""
    t = np.asarray(np.arange(frames + 1) * frame, dtype=np.float64)
    p = np.zeros((frames + 1, len(HANDS), 3))
    r = np.tile(np.diag([1.0, -1.0, -1.0]), (frames + 1, len(HANDS), 1, 1))
    for hand, grasp_id in enumerate(HANDS):
        if grasp_id in paths:
            path = paths[grasp_id].at(t)
            p[:, hand], r[:, hand] = path.position, path.rotation
    return p, r
