"""Material and friction by the lab's own tests: layers on a tilted table, stretch that can be had."""

from dataclasses import replace

import numpy as np
import pytest

from robots.errors import ConfigurationError
from skills.cloth.elastic import GRAVITY
from skills.cloth.mesh import ClothMesh, mesh_from_contour
from skills.cloth.solver import ClothSimulation, SolverSettings
from skills.vocabulary import Material

MATERIAL = Material(
    areal_mass=0.4, stretch_fraction=0.02, bending_length=0.02, thickness=0.003, friction_static=0.6,
    friction_dynamic=0.55, friction_layers=0.5,
)  # fmt: skip


def sheet_on_a_sheet():
    lower = mesh_from_contour(np.array([[-0.2, -0.15], [0.5, -0.15], [0.5, 0.15], [-0.2, 0.15]]), 0.026)
    upper = mesh_from_contour(
        np.array([[-0.1, -0.07], [0.1, -0.07], [0.1, 0.07], [-0.1, 0.07]]), 0.026, rotate=0.3
    )
    n, m = len(lower.rest), len(upper.rest)
    return n, ClothMesh(
        np.vstack([lower.rest, upper.rest]), np.repeat([0, 1], [n, m]).astype(np.int32),
        np.vstack([lower.triangles, upper.triangles + n]).astype(np.int32),
        np.repeat([0, 1], [len(lower.triangles), len(upper.triangles)]).astype(np.int32),
        np.zeros((0, 2), np.int32),
    )  # fmt: skip


@pytest.mark.parametrize("mu", [0.3, 0.6, 0.9])
def test_a_layer_slides_on_a_layer_as_coulomb_says(mu):
    """The lower sheet is held by the table; the upper one is watched once it lies."""
    n, mesh = sheet_on_a_sheet()
    a = np.arctan(1.1 * mu)
    settings = SolverSettings(gravity=(GRAVITY * np.sin(a), 0.0, -GRAVITY * np.cos(a)), drag=0.0, sleep_frames=0)
    material = replace(MATERIAL, friction_static=5.0, friction_dynamic=5.0, friction_layers=mu)
    s = ClothSimulation(mesh, material, settings=settings)
    s.advance(12)
    x0, v0 = s.positions[n:, 0].mean(), s.velocities[n:, 0].mean()
    s.advance(24)
    t = 24 / 60
    expected = 0.5 * GRAVITY * (np.sin(a) - mu * np.cos(a)) * t * t
    assert s.positions[n:, 0].mean() - x0 - v0 * t == pytest.approx(expected, rel=0.02)


def test_substeps_are_chosen_for_the_stretch_and_reported():
    coarse = mesh_from_contour(np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]), 0.026)
    fine = mesh_from_contour(np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]), 0.015)

    def chosen(mesh, stretch, **kw):
        return ClothSimulation(mesh, replace(MATERIAL, stretch_fraction=stretch), settings=SolverSettings(**kw))

    soft, stiff = chosen(fine, 0.03), chosen(fine, 0.01)
    assert stiff.substeps > soft.substeps and chosen(coarse, 0.01).substeps < stiff.substeps
    assert max(soft.stretch_error, stiff.stretch_error) < 5e-4
    assert chosen(fine, 0.01, stretch_tolerance=1e-4).substeps > stiff.substeps
    # given substeps are taken and the error is said, unless a tolerance is asked for as well
    rough = chosen(fine, 0.01, substeps=12)
    assert rough.substeps == 12 and rough.stretch_error > 0.01
    with pytest.raises(ConfigurationError, match="12 substeps") as error:
        chosen(fine, 0.01, substeps=12, stretch_tolerance=1e-3)
    assert error.value.values["needed_substeps"] == stiff.substeps
    with pytest.raises(ConfigurationError):
        chosen(fine, 0.0005)  # nothing within reason would do
    with pytest.raises(ConfigurationError):
        chosen(fine, 0.01, stretch_tolerance=-1.0)
