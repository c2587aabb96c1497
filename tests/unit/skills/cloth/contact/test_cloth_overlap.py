"""Overlapping layers are shifted apart without gaining energy."""

import numpy as np
import pytest

from benchmarks.cloth.scenes import stacked
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from tests.builders.cloth import COTTON as MATERIAL
from tests.builders.cloth import turned as rotated

SHEET = mesh_from_contour(np.array([[-0.15, -0.15], [0.15, -0.15], [0.15, 0.15], [-0.15, 0.15]]), 0.025)
N = len(SHEET.rest)
OVERLAP = 0.001
VOID = SolverSettings(gravity=(0.0, 0.0, 0.0), drag=0.0, sleep_frames=0)


def two_sheets_that_overlap(turned):
    """Two sheets at rest without gravity, one above the other and OVERLAP [m] too near. The upper mesh is
    turned."""
    mesh = stacked([SHEET, rotated(SHEET, turned)])
    x = mesh.lay_flat(MATERIAL.thickness)
    x[N:, 2] -= OVERLAP
    return ClothSimulation(mesh, MATERIAL, x, VOID, table=False)


def energy(s):
    return 0.5 * float((s.velocities**2 / s._body.w[:, None]).sum())


def apart(s, values):
    """Difference of the mass-weighted means of the upper and the lower sheet."""
    mass = 1.0 / s._body.w
    return np.average(values[N:], axis=0, weights=mass[N:]) - np.average(values[:N], axis=0, weights=mass[:N])


@pytest.mark.parametrize("turned", [0.0, 0.3])
def test_overlapping_sheets_separate_without_speed(turned):
    """The sheets keep less than 3 % of the speed that would separate them within a frame, and less than 1 % of its
    energy."""
    s = two_sheets_that_overlap(turned)
    begun = apart(s, s.positions)
    s.advance(10)
    way = apart(s, s.positions) - begun
    assert way[2] == pytest.approx(OVERLAP, abs=1e-4)
    assert np.abs(way[:2]).max() < 1e-5
    thrown = OVERLAP / VOID.frame
    assert np.abs(apart(s, s.velocities)).max() < 0.03 * thrown
    reduced = 0.25 * (1.0 / s._body.w).sum()
    assert energy(s) < 0.01 * 0.5 * reduced * thrown**2


@pytest.mark.parametrize("turned", [0.0, 0.3])
def test_separating_layers_keeps_the_centre_of_mass(turned):
    s = two_sheets_that_overlap(turned)
    mass, begun = 1.0 / s._body.w, s.positions
    s.advance(10)
    assert np.abs(np.average(s.positions - begun, axis=0, weights=mass)).max() < 1e-12


def test_friction_does_not_drag_shifted_layers():
    """A sheet slides over another one with an overlap. The shift that removes the overlap is not a load, so it
    causes no friction."""
    s = two_sheets_that_overlap(0.0)
    x, v = s.positions, np.zeros((2 * N, 3))
    v[N:, 0] = 0.1
    s.set_positions(x, v)
    s.advance(10)
    assert apart(s, s.velocities)[0] == pytest.approx(0.1, rel=0.02)
