"""The cantilever test of bending (Peirce 1930; ASTM D1388, option A).

A strip of the fabric is pushed over the edge of a level platform until its tip touches a plane that falls by
41.5 degrees from the edge. The bending length c is half of the overhang, and the flexural rigidity is
areal_mass g c^3. The virtual strip is held out likewise, and the angle to its tip gives its bending length by
Peirce's formula, taken relative to 41.5 degrees (where the formula itself is 2 % off the elastica, the half
overhang is exact).

Similarity: a strip's shape depends on overhang / c alone, and c goes with gravity to the power of -1/3. A soft
fabric's overhang is as short as a mesh's edge; its virtual strip is therefore made several edges long and hangs
in less gravity, with the fabric's own flexural rigidity. A mesh bends over the triangles on both sides of an edge:
those on the clamp's line lengthen what hangs free by half a triangle's height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from robots.errors import ConfigurationError
from robots.ports import Array, frozen
from skills.cloth.elasticity import GRAVITY
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.settings import SolverSettings
from skills.cloth.solver import ClothSimulation
from skills.vocabulary import Material

__all__ = ["BendingCalibration", "bending_length", "calibrate_bending", "cantilever", "peirce"]

ANGLE = math.radians(41.5)
"""Of the plane that the tip has to reach."""
LEAST, MOST = 0.003, 0.10
AGREEMENT = 0.05
"""Of the simulated bending length with the measured one, relative."""
EDGES = 16
"""The virtual strip's overhang, in edges of its mesh,"""
WIDTH = 8
"""its width (hinges are missing along its borders: a narrow strip is too soft),"""
CLAMPED = 2
"""and how much of it lies on the platform."""
EDGE = 0.020
RELAXATION = 15.0
"""The strip is watched for so many times sqrt(overhang / gravity)."""
SUBSTEPS, SOFT = 20, 0.015
"""Of a frame, up to this bending length [m]; beyond it as many more as the stiffer strip swings faster."""


def bending_length(overhang: float) -> float:
    """c [m] of an overhang [m] at 41.5 degrees: its half. Raises ConfigurationError outside 6 to 200 mm."""
    if not (math.isfinite(overhang) and 2.0 * LEAST <= overhang <= 2.0 * MOST):
        raise ConfigurationError(
            f"an overhang of {overhang:g} m is none of a fabric",
            f"give metres, from {2 * LEAST:g} to {2 * MOST:g}: how far the strip reaches over the edge when its"
            " tip touches the plane of 41.5 degrees", overhang=overhang,
        )  # fmt: skip
    return 0.5 * overhang


def peirce(overhang: float, angle: float) -> float:
    """Bending length [m] of a strip whose tip is seen from the edge `angle` [rad] below the horizontal."""
    return overhang * (math.cos(0.5 * angle) / (8.0 * math.tan(angle))) ** (1.0 / 3.0)


@dataclass(frozen=True, eq=False)
class BendingCalibration:
    """bending_length: half the measured overhang [m]. simulated: that of the virtual strip [m], brought back to
    its size. angle: of the virtual tip [rad]. mesh, pictures (k, n, 3), times (k,) [s]: the test; overhang [m] and
    gravity [m/s2] of the virtual strip, which hangs free from `behind` [m] before the edge."""

    bending_length: float
    simulated: float
    angle: float
    overhang: float
    behind: float
    gravity: float
    mesh: ClothMesh
    pictures: Array
    times: Array
    plane: float = ANGLE
    """[rad] of the plane that the tip has to reach."""

    def tip_angle(self, positions: Array) -> float:
        """[rad] from where the strip hangs free down to its tip, positions: (n, 3)."""
        return _tip_angle(self.mesh, positions, self.overhang, self.behind)

    @property
    def agrees(self) -> bool:
        return abs(self.error) <= AGREEMENT

    @property
    def error(self) -> float:
        return self.simulated / self.bending_length - 1.0


def calibrate_bending(material: Material, overhang: float, edge: float = EDGE) -> BendingCalibration:
    """The bending length of a measured overhang [m], and the virtual test of the fabric that has it.

    Raises ConfigurationError for an overhang that no fabric has. Whether the virtual strip bends as far is the
    result's `agrees`.
    """
    return cantilever(replace(material, bending_length=bending_length(overhang)), edge)


def cantilever(
    material: Material, edge: float = EDGE, substeps: int | None = None, pictures: int = 61
) -> BendingCalibration:
    """The virtual test of a fabric on a mesh of `edge` [m]. substeps: of a frame; None: as the fabric needs."""
    overhang, behind = EDGES * edge, np.sqrt(3.0) / 4.0 * edge
    gravity = GRAVITY * (2.0 * material.bending_length / (overhang + behind)) ** 3
    if substeps is None:
        substeps = 4 * math.ceil(SUBSTEPS / 4 * max(1.0, material.bending_length / SOFT) ** 1.5)
    mesh = _strip(overhang, edge)
    x = np.column_stack([mesh.rest, np.full(len(mesh.rest), 0.5 * overhang)])
    # clamped: on the platform, and so that the strip leaves it level
    fixed = mesh.rest[:, 0] < 1e-6
    swing = math.sqrt(overhang / gravity)
    settings = SolverSettings(substeps=substeps, gravity=(0.0, 0.0, -gravity), drag=1.5 / swing, sleep_frames=0)
    simulation = ClothSimulation(mesh, material, x, settings, table=False, fixed=fixed)
    frames = max(pictures, round(RELAXATION * swing * settings.frame_rate))
    bounds = np.unique(np.linspace(0, frames, pictures, dtype=int))
    taken = [simulation.positions]
    for step in np.diff(bounds):
        simulation.advance(int(step))
        taken.append(simulation.positions)
    angle = _tip_angle(mesh, taken[-1], overhang, behind)
    simulated = material.bending_length * peirce(1.0, angle) / peirce(1.0, ANGLE)
    return BendingCalibration(
        material.bending_length, simulated, angle, overhang, behind, gravity, mesh,
        frozen(np.array(taken)), frozen(bounds / settings.frame_rate),
    )  # fmt: skip


def _strip(overhang: float, edge: float) -> ClothMesh:
    """Over the edge at x = 0, with what lies clamped on the platform."""
    clamped, half = CLAMPED * edge, 0.5 * WIDTH * edge
    lower = [(-clamped, -half), (0.0, -half), (overhang, -half)]
    return mesh_from_contour(np.array(lower + [(u, -v) for u, v in lower[::-1]]), edge)


def _tip_angle(mesh: ClothMesh, positions: Array, overhang: float, behind: float) -> float:
    tip = positions[mesh.rest[:, 0] > overhang - 1e-6].mean(axis=0)
    platform = positions[mesh.rest[:, 0] < 1e-6, 2].mean()
    return math.atan2(float(platform - tip[2]), float(tip[0]) + behind)
