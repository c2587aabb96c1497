"""The set of pressed creases in the simulated cell: the fabric's values, and the pressure of fingertips."""

from __future__ import annotations

import math

import numpy as np

from foldcell.cell.simulation.noise import GarmentNoise
from foldcell.skills.cloth.crease_set import largest_crease_set
from foldcell.skills.vocabulary import Array

REACH = 0.02
"""Cloth bears a fingertip's force if it is at most this far above the tip [m] or lower."""


def draw_crease(nominal: float, noise: GarmentNoise, rng: np.random.Generator) -> tuple[float, float]:
    """Draw crease_set and crease_time [s] (`SolverSettings`). nominal: crease_set of the garment file."""
    times = noise.crease_time
    crease_time = times.low * (times.high / times.low) ** rng.uniform()
    drawn = nominal * (1.0 + noise.crease_set * rng.uniform(-1.0, 1.0))
    return min(drawn, largest_crease_set(crease_time)), crease_time


def tip_pressure(positions: Array, tips: Array, force: Array, area: float, edge: float) -> Array:
    """Return the pressure (n,) [Pa] of fingertips on the vertices (n, 3) [m]. tips: (k, 3) [m]; force: (k,) [N];
    area: of a tip's contact [m2]; edge: edge length of the mesh [m].

    Every layer under a tip bears its force. The pressure falls off as in Hertz's contact of soft bodies, but
    quadratically. A tip is smaller than a coarse mesh's triangles, so its force is spread over an edge length. The
    set of a short contact is proportional to the pressure, so in the mean it does not depend on the spread.
    """
    radius = max(math.sqrt(area / math.pi), edge)
    apart = np.linalg.norm(positions[:, None, :2] - tips[None, :, :2], axis=2)
    under = positions[:, None, 2] < tips[None, :, 2] + REACH
    profile = np.where(under, np.maximum(1.0 - (apart / radius) ** 2, 0.0), 0.0)
    return np.asarray(profile @ (2.0 * force / (math.pi * radius**2)))
