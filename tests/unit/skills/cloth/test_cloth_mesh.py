"""Meshes made from contours."""

import numpy as np
import pytest
import shapely

from benchmarks.cloth.meshes import smallest_angle
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.cloth.mesh import FineBands, mesh_from_contour

TOWEL = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]])
HALF = [(0.08, 0.30), (0.22, 0.26), (0.60, 0.10), (0.57, 0.01), (0.24, 0.12), (0.24, -0.35)]
SHIRT = np.array(HALF + [(-x, y) for x, y in HALF[::-1]])


@pytest.mark.parametrize("contour", [TOWEL, SHIRT])
@pytest.mark.parametrize("edge", [0.02, 0.026, 0.035])
def test_a_mesh_covers_the_contour_and_keeps_its_corners(contour, edge):
    mesh = mesh_from_contour(contour, edge)
    assert mesh.area.sum() == pytest.approx(shapely.Polygon(contour).area, rel=1e-9)
    gap = np.linalg.norm(contour[:, None] - mesh.rest[None], axis=2).min(axis=1)
    assert gap.max() < 1e-12
    # Euler's formula of a disc: one sheet without holes
    assert len(mesh.rest) - len(mesh.edges) + len(mesh.triangles) == 1
    assert np.rad2deg(smallest_angle(mesh)) > 22.0
    assert mesh.edge_length.min() > 0.5 * edge and mesh.edge_length.max() < 1.9 * edge


def test_two_layers_share_only_the_border():
    mesh = mesh_from_contour(SHIRT, 0.03, layers=2)
    assert len(mesh.rest) - len(mesh.edges) + len(mesh.triangles) == 2  # Euler's formula of a sphere
    assert mesh.area.sum() == pytest.approx(2.0 * shapely.Polygon(SHIRT).area, rel=1e-9)
    upper = np.unique(mesh.triangles[mesh.triangle_layer == 1])
    lower = np.unique(mesh.triangles[mesh.triangle_layer == 0])
    np.testing.assert_array_equal(np.intersect1d(upper, lower), np.unique(mesh.seam))
    # no hinge across the welded border
    seam = {tuple(sorted(e)) for e in mesh.seam.tolist()}
    assert not [h for h in mesh.hinges.tolist() if tuple(sorted(h[:2])) in seam]


def test_a_rotated_grid_gives_another_mesh_of_the_same_garment():
    a, b = mesh_from_contour(TOWEL, 0.026), mesh_from_contour(TOWEL, 0.026, rotate=0.3)
    assert a.rest.shape != b.rest.shape or not np.allclose(a.rest, b.rest)
    again = mesh_from_contour(TOWEL, 0.026)
    np.testing.assert_array_equal(a.rest, again.rest)
    np.testing.assert_array_equal(a.triangles, again.triangles)


def test_a_clockwise_or_noisy_contour_gives_the_same_garment():
    mesh = mesh_from_contour(TOWEL[::-1], 0.026)
    assert mesh.area.sum() == pytest.approx(0.24)
    t = np.linspace(0.0, 4.0, 801)[:-1]
    k = t.astype(int)
    dense = TOWEL[k] + (t - k)[:, None] * (TOWEL[(k + 1) % 4] - TOWEL[k])
    dense = dense + np.random.default_rng(1).normal(scale=2e-4, size=dense.shape)
    mesh = mesh_from_contour(dense, 0.026)
    assert mesh.area.sum() == pytest.approx(0.24, rel=5e-3)
    assert np.rad2deg(smallest_angle(mesh)) > 20.0


@pytest.mark.parametrize(
    ("contour", "edge"),
    [
        (np.array([[0, 0], [1, 1], [1, 0], [0, 1.0]]), 0.05),  # a contour that crosses itself
        (np.array([[0, 0], [1, 0], [np.nan, 1.0]]), 0.05),
        (np.array([[0, 0], [1, 0], [2, 0.0]]), 0.05),  # a contour without area
        (TOWEL * 0.01, 0.05),
        (TOWEL, 26.0),  # a contour in millimetres
    ],
)
def test_an_invalid_contour_is_refused(contour, edge):
    with pytest.raises(ConfigurationError):
        mesh_from_contour(contour, edge)


def test_bands_are_fine_and_the_rest_is_coarse():
    crease = np.array([[[0.0, -0.2], [0.0, 0.2]]])
    bands = FineBands(crease, 0.03, 0.008)
    mesh = mesh_from_contour(TOWEL, 0.035, 2, 0.2, bands)
    middle = mesh.rest[mesh.edges].mean(axis=1)
    near = np.abs(middle[:, 0]) < 0.02
    far = np.abs(middle[:, 0]) > 0.15
    assert np.median(mesh.edge_length[near]) == pytest.approx(0.008, rel=0.1)
    assert np.median(mesh.edge_length[far]) == pytest.approx(0.032, rel=0.1)
    assert mesh.edge_length[near].max() < 0.014
    assert mesh.area.sum() == pytest.approx(2.0 * 0.6 * 0.4, rel=1e-9)
    assert smallest_angle(mesh) > np.deg2rad(15.0)


def test_bands_as_coarse_as_the_rest_change_nothing_but_the_grid():
    bands = FineBands(np.array([[[0.0, -0.2], [0.0, 0.2]]]), 0.03, 0.05)
    mesh = mesh_from_contour(TOWEL, 0.026, fine=bands)
    assert np.median(mesh.edge_length) == pytest.approx(0.026, rel=0.1)
