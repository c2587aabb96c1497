"""Ideal folds without grippers, the reference of the optimiser."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.attainable_dissimilarity import d_relax, distance_to_target, ideal_fold, settled
from foldcell.cell.config.garments.garment_file import load_garment
from foldcell.skills.cloth.intersections.crossings import count_crossings
from foldcell.skills.cloth.mesh import ClothMesh, mesh_from_contour
from foldcell.skills.cloth.settings import SolverSettings
from foldcell.skills.cloth.solver import ClothSimulation
from foldcell.skills.fold_plan.folding import fold_xy, target_vertices
from foldcell.skills.fold_plan.turned_fold import turned_over
from foldcell.skills.vocabulary import FoldLine, frozen

FABRIC = load_garment("medium_towel", "bare_table").material
SHEET = np.array([[0.4, -0.25], [0.8, -0.25], [0.8, 0.25], [0.4, 0.25]])
HALF = FoldLine(frozen(np.array([0.6, 0.0])), frozen(np.array([0.0, -1.0])))
QUARTER = FoldLine(frozen(np.array([0.6, 0.0])), frozen(np.array([1.0, 0.0])))


@pytest.fixture(scope="module")
def mesh() -> ClothMesh:
    return mesh_from_contour(SHEET, 0.017)


def strain(mesh: ClothMesh, x: np.ndarray) -> np.ndarray:
    ends = x[mesh.edges]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / mesh.edge_length - 1.0


def test_without_folds_the_garment_is_flat(mesh: ClothMesh) -> None:
    assert np.array_equal(ideal_fold(mesh, (), FABRIC), mesh.lay_flat(FABRIC.thickness))


def test_a_turned_garment_has_no_strain_no_crossings_and_no_speed(mesh: ClothMesh) -> None:
    before = ideal_fold(mesh, (HALF,), FABRIC)
    turned = turned_over(mesh, (HALF, QUARTER), FABRIC, before)
    assert count_crossings(turned, mesh.triangles) == 0
    stretched = np.abs(strain(mesh, turned))
    assert stretched.max() < 0.25 and np.percentile(stretched, 99) < 0.1

    simulation = ClothSimulation(mesh, FABRIC, turned)
    fastest = 0.0
    for _ in range(20):
        simulation.advance()
        fastest = max(fastest, float(np.linalg.norm(simulation.velocities, axis=1).max()))
    assert fastest < 0.5
    assert count_crossings(simulation.positions, mesh.triangles) == 0


def test_flat_parts_lie_exactly_on_their_target(mesh: ClothMesh) -> None:
    turned = turned_over(mesh, (HALF, QUARTER), FABRIC, ideal_fold(mesh, (HALF,), FABRIC))
    goal = target_vertices(mesh, (HALF, QUARTER), FABRIC)
    far = np.minimum(*(np.abs(line.signed_distance(goal[:, :2])) for line in (HALF, QUARTER))) > 0.12
    assert far.sum() > 20 and len(np.unique(goal[far, 2])) == 4
    assert np.linalg.norm(turned - goal, axis=1)[far].max() < 0.002


def test_the_moved_part_lies_on_top(mesh: ClothMesh) -> None:
    x = ideal_fold(mesh, (HALF,), FABRIC)
    goal = target_vertices(mesh, (HALF,), FABRIC)
    moved = HALF.signed_distance(mesh.rest) > 0.05
    stays = HALF.signed_distance(mesh.rest) < -0.05
    assert x[moved, 2].min() > x[stays, 2].max() - 0.1 * FABRIC.thickness
    assert np.linalg.norm(x - goal, axis=1)[moved | stays].mean() < 0.003


def test_an_earlier_crease_keeps_its_height(mesh: ClothMesh) -> None:
    """The second fold lays the loop of the first crease onto itself. Neither loop is squeezed to the height of the
    layers."""
    once = ideal_fold(mesh, (HALF,), FABRIC)
    twice = ideal_fold(mesh, (HALF, QUARTER), FABRIC)
    at_crease = np.abs(HALF.signed_distance(mesh.rest)) < 0.02
    away = np.abs(QUARTER.signed_distance(fold_xy((HALF,), mesh.rest))) > 0.1
    height = [float(x[at_crease & away, 2].max()) for x in (once, twice)]
    assert height[0] > 5 * FABRIC.thickness
    assert height[1] > 1.4 * height[0]


def test_a_crease_that_starts_flat_is_as_high_as_one_that_starts_as_a_loop(mesh: ClothMesh) -> None:
    """A crease that starts flat opens to the same loop. At more than 1 m/s it would push the layers apart."""
    d, x = d_relax(mesh, (HALF,), FABRIC)
    mapped = settled(mesh, FABRIC, target_vertices(mesh, (HALF,), FABRIC), SolverSettings(), 1.0)
    assert x[:, 2].max() == pytest.approx(mapped[:, 2].max(), abs=0.001)
    assert d == distance_to_target(mesh, (HALF,), FABRIC, x)
    assert 0.5 * FABRIC.thickness < d < distance_to_target(mesh, (HALF,), FABRIC, mapped)


def test_mapped_layers_intersect_at_the_fold(mesh: ClothMesh) -> None:
    """This is why an ideal fold is simulated, and its vertices are not only mapped."""
    assert count_crossings(target_vertices(mesh, (HALF, QUARTER), FABRIC), mesh.triangles) > 20
    assert count_crossings(ideal_fold(mesh, (HALF, QUARTER), FABRIC), mesh.triangles) == 0


def test_an_ideal_fold_is_at_rest_after_one_second(mesh: ClothMesh) -> None:
    x = ideal_fold(mesh, (HALF,), FABRIC)
    later = settled(mesh, FABRIC, x, SolverSettings(), 1.0)
    assert np.linalg.norm(later - x, axis=1).max() < 0.002
