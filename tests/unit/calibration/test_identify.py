"""Friction from one recorded fold: simulated folds on another mesh, and synthetic outlines."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from foldcell.calibration import identify
from foldcell.calibration.identify import (
    BOUND,
    FRICTIONS,
    Candidates,
    FrictionEstimate,
    identify_friction,
    outline_residual,
    predict_candidates,
    silhouette,
)
from foldcell.skills.cloth.mesh import mesh_from_contour
from foldcell.skills.cloth.predict import predict_fold
from foldcell.skills.trajectory.arcs.paths import fold_paths
from foldcell.skills.vocabulary import GraspId, Material

MU = 0.45
BELIEVED = Material(0.4, 0.03, 0.012, 0.0025, MU, 0.85 * MU, 0.6)
CONTOUR = np.array([[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]])


def steep(height):
    """Paths of a fold that lifts straight up and high, so that the taut cloth drags the part at rest."""
    up = np.array([0.0, 0.0, height])
    controls = {}
    for i, y in ((GraspId.LEFT, 0.188), (GraspId.RIGHT, -0.188)):
        a, b = np.array([0.288, y, 0.001]), np.array([-0.288, y, 0.012])
        controls[i] = np.array([a, a + up, b + up, b])
    return fold_paths(controls, dict.fromkeys(controls, np.pi / 2), 3.0)


def seen(factor, paths):
    """The outline of the fold in a simulated world with another mesh, whose friction is `factor` times the
    believed one."""
    mesh = mesh_from_contour(CONTOUR, 0.0225, rotate=0.4)
    end = predict_fold(mesh, mesh.lay_flat(0.0025), BELIEVED.with_friction(factor * MU), paths)
    return np.asarray(silhouette(end.vertices, mesh.triangles).exterior.coords)[:-1]


def candidates(paths, factors=FRICTIONS):
    mesh = mesh_from_contour(CONTOUR, 0.0262)
    return predict_candidates(mesh, mesh.lay_flat(0.0025), BELIEVED, paths, factors)


@pytest.fixture(scope="module")
def dragging():
    paths = steep(0.45)
    return paths, candidates(paths)


@pytest.mark.parametrize("factor", [0.65, 1.35])
def test_a_fold_that_drags_moves_the_estimate_towards_the_truth(dragging, factor):
    """The estimate moves in the right direction and nearer to the truth. The stated deviation is not a bound."""
    paths, grid = dragging
    found = identify_friction(seen(factor, paths), grid, BELIEVED)
    assert (found.friction - MU) * (factor - 1.0) > 0.0
    assert abs(found.friction - factor * MU) < abs(MU - factor * MU)
    assert found.learned > 0.5


def test_a_fold_without_drag_leaves_the_prior_unchanged():
    """With an ordinary arc the part at rest does not move at any of these frictions, so nothing is learned."""
    paths = steep(0.25)
    found = identify_friction(seen(0.65, paths), candidates(paths, (0.6, 1.6)), BELIEVED)
    assert found.learned < 0.2
    assert found.friction == pytest.approx(MU, rel=0.1)
    assert found.update_of(BELIEVED, BELIEVED).friction_static == pytest.approx(MU, rel=0.02)


def box(x, height=0.3):
    return shapely.box(x, 0.0, x + 0.3, height)


def outline(shape):
    return np.asarray(shape.exterior.coords)[:-1]


FOUR = np.array([0.25, 0.35, 0.5, 0.7])
GRID = Candidates(FOUR, [box(0.1 * np.log(mu)) for mu in FOUR])
"""A square that moves by 0.1 ln(mu)."""


@pytest.mark.parametrize("truth", [0.32, 0.45, 0.6])
def test_a_synthetic_drift_is_recovered(monkeypatch, truth):
    monkeypatch.setattr(identify, "SIGMA", 0.001)
    found = identify_friction(outline(box(0.1 * np.log(truth))), GRID, BELIEVED)
    assert found.friction == pytest.approx(truth, rel=0.06) and found.misfit < 3e-3


def test_an_unexplained_outline_widens_the_estimate():
    a, b = (identify_friction(outline(box(-0.08, height)), GRID, BELIEVED) for height in (0.3, 0.45))
    assert b.misfit > 5 * a.misfit and b.deviation > 2 * a.deviation


@given(st.floats(0.05, 3.0), st.floats(0.0, 1.0), st.floats(0.3, 0.7))
def test_an_update_is_damped_and_bounded(value, learned, believed):
    """The update lies between belief and estimate, and nearer to the estimate the more was learned. Both frictions
    change alike."""
    estimate = FrictionEstimate(value, 0.1, learned, 0.002)
    before = BELIEVED.with_friction(believed)
    after = estimate.update_of(before, BELIEVED)
    low, high = (1.0 - BOUND) * MU, (1.0 + BOUND) * MU
    assert low <= after.friction_static <= high
    if low < after.friction_static < high:
        moved = np.log(after.friction_static / believed)
        assert moved == pytest.approx(learned * np.log(value / believed), abs=1e-9)
    assert after.friction_dynamic / after.friction_static == pytest.approx(0.85)
    assert after.stretch_fraction == before.stretch_fraction


def test_the_residual_is_the_distance_of_the_outlines():
    """A square is moved by 4 mm along one axis, so two of its four sides deviate by 4 mm."""
    corners = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0], [0, 0.3, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    assert outline_residual(corners[:, :2], corners, triangles) < 1e-4
    moved = outline_residual(corners[:, :2] + (0.004, 0.0), corners, triangles)
    assert moved == pytest.approx(0.004 * np.sqrt(0.5), rel=0.03)
