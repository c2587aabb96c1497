"""Heights of a folded garment away from and near its creases, and its comparison with the plan's target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.skills.perception.inspection.predicted_view import draw_shape, outline_of
from foldcell.skills.perception.inspection.target_view import FoldTarget, stack_heights, view_target
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import PredictedShape
from tests.inspections import grid_triangles
from tests.scenes import TABLE, camera, place

VIEW, MARGIN = TableView(camera(), TABLE), 0.040
X, Y = np.meshgrid(np.linspace(0.5, 0.7, 41), np.linspace(-0.15, 0.15, 61), indexing="ij")
CREASE = np.column_stack([np.full(80, 0.7), np.linspace(-0.15, 0.15, 80)])
"""The crease of a sheet of 200 x 300 mm is its far edge."""


def sheet(flat: float, crest: float) -> PredictedShape:
    """A sheet at the height `flat` [m]; its far 30 mm are `crest` high [m]."""
    z = np.where(X > 0.67, crest, flat)
    xy = np.column_stack([X.ravel(), Y.ravel()])
    return PredictedShape(np.column_stack([xy, z.ravel()]), grid_triangles(X.shape), xy)


@pytest.mark.parametrize("crest", [0.006, 0.020, 0.035])
def test_the_crease_is_measured_apart_from_the_rest(crest: float) -> None:
    image = draw_shape(VIEW, sheet(0.006, crest))
    found = stack_heights(image, np.isfinite(image), VIEW, CREASE, MARGIN)
    assert found.height_m == pytest.approx(0.006, abs=2e-4)
    assert found.crease_height_m == pytest.approx(crest, abs=1e-3)


@pytest.mark.parametrize(("at", "relief"), [(0.59, 0.014), (0.45, 0.0)])
def test_the_relief_is_how_far_the_high_places_stand_above_the_others(at: float, relief: float) -> None:
    """Of the places away from the crease, half or all lie high."""
    z = np.where(at < X, 0.020, 0.006)
    xy = np.column_stack([X.ravel(), Y.ravel()])
    image = draw_shape(VIEW, PredictedShape(np.column_stack([xy, z.ravel()]), grid_triangles(X.shape), xy))
    found = stack_heights(image, np.isfinite(image), VIEW, CREASE, MARGIN)
    assert found.height_m == pytest.approx(0.020, abs=5e-4) and found.relief_m == pytest.approx(relief, abs=1e-3)


def test_a_garment_that_lies_near_creases_everywhere_is_measured_as_a_whole() -> None:
    image = draw_shape(VIEW, sheet(0.006, 0.006))
    found = stack_heights(image, np.isfinite(image), VIEW, CREASE, 1.0)
    assert found.height_m == pytest.approx(0.006, abs=2e-4) == found.crease_height_m


def test_heights_that_are_not_visible_are_unknown() -> None:
    image = draw_shape(VIEW, sheet(0.006, 0.02))
    found = stack_heights(np.full_like(image, np.nan), np.isfinite(image), VIEW, CREASE, MARGIN)
    assert np.isnan([found.height_m, found.crease_height_m]).all()


@pytest.mark.parametrize(("dx", "dy", "turn"), [(0.0, 0.0, 0.0), (0.02, -0.03, 0.05), (-0.04, 0.01, -0.1)])
def test_the_target_is_found_where_the_garment_drifted_to(dx: float, dy: float, turn: float) -> None:
    """The garment is higher than the target, so it appears further from the camera; this is no drift."""
    target = sheet(0.002, 0.002)
    centre = target.vertices[:, :2].mean(axis=0)
    made = sheet(0.012, 0.020)
    xy = place(made.vertices[:, :2] - centre, centre[0] + dx, centre[1] + dy, turn)
    seen = draw_shape(VIEW, replace(made, vertices=np.column_stack([xy, made.vertices[:, 2]])))
    mask = np.isfinite(seen)
    found = view_target(VIEW, mask, outline_of(VIEW, mask), seen, made, FoldTarget(target, CREASE), MARGIN)
    assert found.iou > 0.94
    np.testing.assert_allclose(found.drift, (dx, dy), atol=0.003)
    assert found.drift_rad == pytest.approx(turn, abs=0.02)
    assert found.side**2 == pytest.approx(0.2 * 0.3, rel=0.03)
    assert found.observed.height_m == pytest.approx(0.012, abs=5e-4)
    assert found.observed.crease_height_m == pytest.approx(0.020, abs=1e-3)
    assert found.predicted.crease_height_m == pytest.approx(0.020, abs=1e-3)
    assert (found.flat.height_m, found.flat.crease_height_m) == pytest.approx((0.002, 0.002), abs=1e-4)
