"""What tests need of simulated cloth beyond its public interface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit

from foldcell.robots.ports import Array
from foldcell.skills.cloth.elasticity import shuffled
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.simd.aligned_arrays import aligned_zeros
from foldcell.skills.cloth.simd.vec3 import WIDTH
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.plane import rotation
from foldcell.skills.vocabulary import Material

EVERY_EDGE = np.float32(2.0)  # cosine from which an edge is a ridge, so that every edge is one
COTTON = Material(
    areal_mass=0.3, stretch_fraction=0.02, bending_length=0.016, thickness=0.003, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip


def rows(n: int) -> Array:
    """Return zeros (n, WIDTH) in which each row is within one cache line."""
    return aligned_zeros((n, WIDTH))


@njit(nogil=True)
def call(inner: Any, *arguments: Any) -> Any:
    """Call a function that only compiled code can call (skills/cloth/inner.py)."""
    return inner(*arguments)


def turned(mesh: ClothMesh, angle: float) -> ClothMesh:
    """The mesh, turned by `angle` [rad]."""
    return replace(mesh, rest=mesh.rest @ rotation(-angle))


def straight(frames: int, start: Sequence[Array], end: Sequence[Array], rotation: Array) -> tuple[Array, Array]:
    """Poses of both hands, as `advance_along` takes them, that move straight from start to end (2, 3) each."""
    at, first = np.linspace(0.0, 1.0, frames + 1)[:, None, None], np.asarray(start)
    return first + at * (np.asarray(end) - first), np.broadcast_to(rotation, (frames + 1, 2, 3, 3))


def crease_angles(simulation: ClothSimulation) -> Array:
    """(h,) the set of each hinge [rad], in the order of the mesh's hinges; zeros if creases take no set."""
    angles = np.zeros(len(simulation.mesh.hinges))
    if len(simulation._state.set_parts):
        angles[shuffled(len(angles))] = simulation._state.set_parts.sum(axis=1)
    return angles
