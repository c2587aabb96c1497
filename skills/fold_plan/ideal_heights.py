"""Heights of the ideal folds of a garment over the range of bending lengths of its fabric, for the predictor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.fold_figures.fold_figures import measure_fold
from foldcell.skills.fold_plan.crease_mesh import predictor_mesh
from foldcell.skills.fold_plan.ideal_fold import ideal_folds
from foldcell.skills.fold_plan.plan import ways_to_fold
from foldcell.skills.garments.garment import Garment

RESIDUAL_CURVATURE = 44.0
"""Bending friction of an unknown fabric [1/m]: mean of six denims (Journal of Textiles 2016, 4614168, Table 5)."""
SETTLE_S = 1.5
COUNT = 5
"""Number of bending lengths that `bending_lengths` returns."""


@dataclass(frozen=True)
class IdealFoldHeights:
    """Heights of ideal folds with one bending length [m], as 95th percentiles. height: away from the creases after
    the last step. crease_height: beside the creases after the last step. first_crease: beside the crease after the
    first step."""

    bending_length: float
    height: float
    crease_height: float
    first_crease: float


def bending_lengths(garment: Garment) -> tuple[float, ...]:
    """Return evenly spaced bending lengths over the range of the garment's class of fabrics [m]."""
    low, high = garment.bending_factors
    return tuple(float(garment.material.bending_length * share) for share in np.linspace(low, high, COUNT))


def ideal_fold_heights(garment: Garment, bending_length: float) -> IdealFoldHeights:
    """Make the ideal folds of a garment of nominal size, in the preferred way, with a bending length [m]."""
    material = replace(garment.material, bending_length=bending_length)
    garment = replace(garment, material=material)
    state = garment.flat_state(*garment.poses.middle)
    mesh = predictor_mesh(state, garment)
    lines = ways_to_fold(garment, state.keypoints)[0]
    low, high = (1.0, 1.0) if garment.fabric is None else garment.fabric.bending_ratio
    settings = SolverSettings(residual_curvature=RESIDUAL_CURVATURE, bending_ratio=float(np.sqrt(low * high)))
    folds = ideal_folds(mesh, lines, material, settings, SETTLE_S)
    first, last = (
        measure_fold(folds[k].vertices, mesh.triangles, mesh.rest, lines[: k + 1]) for k in (0, len(lines) - 1)
    )
    return IdealFoldHeights(bending_length, last.height, last.crease_height, first.crease_height)
