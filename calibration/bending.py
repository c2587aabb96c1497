"""The cantilever test of bending (Peirce 1930; ASTM D1388, option A).

A strip of the fabric is pushed over the edge of a level platform until its tip touches a plane that falls by 41.5
degrees from the edge. The bending length c is half of the overhang, and the flexural rigidity is areal_mass g c^3.
A virtual strip is clamped in the same way. Peirce's formula gives its bending length from the angle to its tip.
The result is scaled so that 41.5 degrees give exactly half of the overhang, because the formula itself deviates
from the elastica by 2 %.

Similarity: the shape of a strip depends only on overhang / c, and c scales with gravity^(-1/3). The overhang of a
soft fabric can be as short as a mesh edge, so a mesh cannot reproduce it. The virtual strip is therefore EDGES
mesh edges long. It has the flexural rigidity of the fabric and hangs in lower gravity, so that its overhang / c is
the same as in the real test. A mesh bends over the triangles on both sides of an edge, so the triangles at the
clamp lengthen the free part by half a triangle's height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.elasticity import GRAVITY
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.vocabulary import Material

ANGLE = math.radians(41.5)
"""Slope of the plane that the tip has to reach [rad]."""
MIN_LENGTH, MAX_LENGTH = 0.003, 0.10
"""Shortest and longest accepted bending length [m]."""
AGREEMENT = 0.05
"""Largest accepted relative difference between the simulated and the measured bending length."""
EDGES = 16
"""Overhang of the virtual strip in mesh edges."""
WIDTH = 8
"""Width of the virtual strip in mesh edges. It must not be small: the border resists no bending, so a narrow strip
is too soft."""
CLAMPED = 2
"""Length of the strip's clamped part on the platform in mesh edges."""
EDGE = 0.020
RELAXATION = 15.0
"""Duration of the virtual test in units of sqrt(overhang / gravity)."""
SUBSTEPS, SOFT = 20, 0.015
"""SUBSTEPS: substeps per frame for a bending length of at most SOFT [m]. A stiffer strip swings faster, so it gets
more substeps."""


def bending_length(overhang: float) -> float:
    """Return the bending length c [m], which is half of the overhang [m] at 41.5 degrees. Raises
    ConfigurationError for an overhang outside 6 to 200 mm."""
    if not (math.isfinite(overhang) and 2.0 * MIN_LENGTH <= overhang <= 2.0 * MAX_LENGTH):
        raise ConfigurationError(
            f"no fabric has an overhang of {overhang:g} m",
            f"give metres, from {2 * MIN_LENGTH:g} to {2 * MAX_LENGTH:g}: length of the strip beyond the edge when"
            " its tip touches the plane of 41.5 degrees", overhang=overhang,
        )  # fmt: skip
    return 0.5 * overhang


def peirce(overhang: float, angle: float) -> float:
    """Return the bending length [m] of a strip by Peirce's formula. overhang [m]; angle [rad]: angle below the
    horizontal at which the tip is seen from the edge."""
    return overhang * (math.cos(0.5 * angle) / (8.0 * math.tan(angle))) ** (1.0 / 3.0)


@dataclass(frozen=True, eq=False)
class BendingCalibration:
    """Result of the cantilever test.

    bending_length: half of the measured overhang [m]. simulated: bending length of the virtual strip, scaled to
    the real strip [m]. angle: angle of the virtual tip below the horizontal [rad]. overhang [m], gravity [m/s2]:
    values of the virtual strip. behind: distance before the edge at which its free part begins [m]. mesh, pictures
    (k, n, 3), times (k,) [s]: the virtual test.
    """

    bending_length: float
    simulated: float
    angle: float
    overhang: float
    behind: float
    gravity: float
    mesh: ClothMesh
    pictures: Array
    times: Array

    def tip_angle(self, positions: Array) -> float:
        """Return the angle below the horizontal from the start of the free part to the tip [rad]. positions: (n,
        3)."""
        return _tip_angle(self.mesh, positions, self.overhang, self.behind)

    @property
    def agrees(self) -> bool:
        return abs(self.error) <= AGREEMENT

    @property
    def error(self) -> float:
        """Relative error of the simulated bending length."""
        return self.simulated / self.bending_length - 1.0


def calibrate_bending(material: Material, overhang: float) -> BendingCalibration:
    """Compute the bending length for a measured overhang [m], and perform the virtual test of that fabric.

    The result's `agrees` states whether the virtual strip bends as far as the real one. Raises ConfigurationError
    for an overhang that no fabric has.
    """
    return cantilever(replace(material, bending_length=bending_length(overhang)))


def cantilever(material: Material, edge: float = EDGE, pictures: int = 61) -> BendingCalibration:
    """Perform the virtual test of a fabric on a mesh of `edge` [m]. pictures: number of recorded moments."""
    overhang, behind = EDGES * edge, np.sqrt(3.0) / 4.0 * edge
    gravity = GRAVITY * (2.0 * material.bending_length / (overhang + behind)) ** 3
    substeps = 4 * math.ceil(SUBSTEPS / 4 * max(1.0, material.bending_length / SOFT) ** 1.5)
    mesh = _strip(overhang, edge)
    x = np.column_stack([mesh.rest, np.full(len(mesh.rest), 0.5 * overhang)])
    # the clamp holds the part on the platform, so the strip leaves the edge level
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
    """Return the mesh of a strip over the edge at x = 0, including its clamped part on the platform."""
    clamped, half = CLAMPED * edge, 0.5 * WIDTH * edge
    lower = [(-clamped, -half), (0.0, -half), (overhang, -half)]
    return mesh_from_contour(np.array(lower + [(u, -v) for u, v in lower[::-1]]), edge)


def _tip_angle(mesh: ClothMesh, positions: Array, overhang: float, behind: float) -> float:
    tip = positions[mesh.rest[:, 0] > overhang - 1e-6].mean(axis=0)
    platform = positions[mesh.rest[:, 0] < 1e-6, 2].mean()
    return math.atan2(float(platform - tip[2]), float(tip[0]) + behind)
