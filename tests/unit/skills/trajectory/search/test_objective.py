"""The dissimilarity D against integrals computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from foldcell.skills.fold_figures.folded_mesh import doubled_area
from foldcell.skills.trajectory.search.objective import ALPHA, cost, dissimilarity

RNG = np.random.default_rng(4)
FLAT = np.vstack([[[0, 0], [0.6, 0], [0.6, 0.4], [0, 0.4]], RNG.uniform((0, 0), (0.6, 0.4), (1500, 2))])
TRIANGLES = Delaunay(FLAT).simplices
AREA = doubled_area(FLAT, TRIANGLES)
TARGET = np.column_stack([FLAT, np.zeros(len(FLAT))])


def test_the_dissimilarity_of_a_shifted_garment_is_the_length_of_the_shift() -> None:
    assert dissimilarity(TARGET, TARGET, TRIANGLES, AREA) == 0.0
    shifted = TARGET + np.array([0.003, -0.004, 0.012])
    assert dissimilarity(TARGET, shifted, TRIANGLES, AREA) == pytest.approx(0.013)


def test_the_dissimilarity_of_a_tilted_garment_is_its_mean_lift() -> None:
    lifted = TARGET + np.column_stack([np.zeros((len(FLAT), 2)), 0.1 * FLAT[:, 0]])
    assert dissimilarity(TARGET, lifted, TRIANGLES, AREA) == pytest.approx(0.1 * 0.3, rel=1e-6)


def test_triangles_are_weighted_by_their_rest_areas() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 1, 3]])
    moved = vertices.copy()
    moved[:, 2] = [0, 0, 0.3, 0.9]
    for area, expected in (([1.0, 0.0], 0.1), ([1.0, 1.0], 0.2)):
        assert dissimilarity(vertices, moved, triangles, np.array(area)) == pytest.approx(expected)


def test_the_cost_adds_the_path_lengths_of_all_arms() -> None:
    assert cost(np.array([0.5, 0.6]), 0.002) == pytest.approx(1.1 + ALPHA * 0.002)
