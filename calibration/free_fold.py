"""The free-fold test of bending (Plaut 2015, Textile Research Journal 85(12), 10.1177/0040517514553877).

A strip of the fabric is folded over, and nothing presses on it. A ruler measures the height of its crease. Without
thickness, this is 0.907 bending lengths: the crease is a heavy elastica. With lengths in bending lengths and the
strip's weight per length as the unit of force,

    phi'' = -(shear + s) cos phi,

where phi is the slope. The curvature phi' is zero at both ends, where the strip is level (phi = 0 and -pi). The
shear force is found by shooting. The layers' thickness is added: the middle of the crease's ends lies one
thickness above the table, and its upper side half a thickness above its middle surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Array, frozen
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.fold_plan.ideal_fold import ideal_folds
from foldcell.skills.vocabulary import FoldLine, Material

THICKNESSES = 1.5
"""Height that the strip's thickness adds to the crease, in thicknesses."""
MIN_LENGTH, MAX_LENGTH = 0.003, 0.10
"""Shortest and longest accepted bending length [m]."""
AGREEMENT = 0.10
"""Largest accepted relative difference between the heights of the simulated and the exact crease."""
EDGES_EACH = 2.0
"""Mesh edges per bending length of the virtual strip."""
FLAT, WIDTH = 6.0, 8.0
"""Length of each half and width of the virtual strip, in bending lengths."""
SLICES = 8
"""The strip's width is divided into this number of slices. The height of the fold is the median of their highest
places. The two slices at the borders are omitted, because the borders curl."""
SETTLE_S = 1.5


@dataclass(frozen=True, eq=False)
class FreeFold:
    """Result of the free-fold test. bending_length: of the fabric [m]. height, exact: height of the simulated and
    of the exact crease above the table [m]. mesh, pictures (k, n, 3): the virtual strip, flat and folded."""

    bending_length: float
    height: float
    exact: float
    mesh: ClothMesh
    pictures: Array

    @property
    def error(self) -> float:
        """Relative error of the simulated height."""
        return self.height / self.exact - 1.0

    @property
    def agrees(self) -> bool:
        return abs(self.error) <= AGREEMENT


@cache
def elastica_height() -> float:
    """Compute the height of a free fold without thickness, in bending lengths."""

    def shape(shear: float) -> object:
        def turned(s: float, v: Array) -> float:
            return float(v[1])

        turned.terminal, turned.direction = True, 1.0  # type: ignore[attr-defined]
        first = 1e-6
        return solve_ivp(
            lambda s, v: (v[1], -(shear + s) * math.cos(v[0]), math.sin(v[0])),
            (first, 20.0), (0.0, -shear * first, 0.0), events=turned, rtol=1e-10, atol=1e-12,
        )  # fmt: skip

    def excess(shear: float) -> float:
        return float(shape(shear).y_events[0][0][0]) + math.pi  # type: ignore[attr-defined]

    return float(shape(brentq(excess, -0.99, -0.90, xtol=1e-13)).y[2].max())  # type: ignore[attr-defined]


def bending_length_of_fold(height: float, thickness: float) -> float:
    """Return the bending length [m] of a fabric whose free fold stands `height` [m] high. thickness: of a layer
    [m]. Raises ConfigurationError for a height that no fabric has."""
    low, high = (elastica_height() * length + THICKNESSES * thickness for length in (MIN_LENGTH, MAX_LENGTH))
    if not (math.isfinite(height) and low <= height <= high):
        raise ConfigurationError(
            f"no fabric of {1e3 * thickness:g} mm has a free fold {height:g} m high",
            f"give metres, from {low:.3f} to {high:.3f}: height of the crease's top above the table",
            height=height, )  # fmt: skip
    return (height - THICKNESSES * thickness) / elastica_height()


def calibrate_free_fold(
    material: Material, height: float, tell: Callable[[str], None] = lambda line: None
) -> FreeFold:
    """Compute the bending length for a measured height [m], and perform the virtual test of that fabric. Raises
    ConfigurationError for a height that no fabric has."""
    length = bending_length_of_fold(height, material.thickness)
    tell(f"folding a virtual strip with a bending length of {1e3 * length:.1f} mm")
    return free_fold(replace(material, bending_length=length))


def free_fold(material: Material) -> FreeFold:
    """Perform the virtual test of a fabric."""
    c, t = material.bending_length, material.thickness
    half, side = FLAT * c, 0.5 * WIDTH * c
    contour = np.array([[-half, -side], [half, -side], [half, side], [-half, side]])
    mesh = mesh_from_contour(contour, max(c / EDGES_EACH, 1.5 * t))
    line = FoldLine(frozen(np.zeros(2)), frozen(np.array([0.0, 1.0])))
    x = ideal_folds(mesh, (line,), material, settle_s=SETTLE_S)[-1].vertices
    slices = np.linspace(-side, side, SLICES + 1)[1:-1]
    highest = [x[(mesh.rest[:, 1] >= a) & (mesh.rest[:, 1] <= b), 2].max() for a, b in pairwise(slices)]
    height = float(np.median(highest)) + 0.5 * t
    exact = elastica_height() * c + THICKNESSES * t
    return FreeFold(c, height, exact, mesh, frozen(np.array([mesh.lay_flat(t), x])))
