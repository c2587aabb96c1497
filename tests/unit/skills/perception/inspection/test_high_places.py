"""High places on a flat stack are located despite the oblique view."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from foldcell.skills.perception.inspection.high_places import EDGE, HighPlaces, find_high_places
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import PredictedShape
from tests.inspections import on_table
from tests.scenes import TABLE, camera

VIEW = TableView(camera(), TABLE)
HERE, THICKNESS = on_table(VIEW), 0.002
LOW, HIGH = np.array([0.45, -0.25]), np.array([0.75, 0.25])


def sheet(layers: int) -> PredictedShape:
    """A flat rectangular stack. Its vertices are in the middle of the upper layer."""
    corners = np.array([[LOW[0], LOW[1]], [HIGH[0], LOW[1]], [HIGH[0], HIGH[1]], [LOW[0], HIGH[1]]])
    z = np.full((4, 1), (layers - 0.5) * THICKNESS)
    return PredictedShape(np.hstack([corners, z]), np.array([[0, 1, 2], [0, 2, 3]], np.int32), corners)


def seen(bumps: list[tuple[float, float, float]], layers: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Height map and mask of the stack as the camera sees them, with round bumps (x, y, height) of 15 mm
    radius."""
    mask = np.all((HERE > LOW) & (HERE < HIGH), axis=2)
    height = np.where(mask, np.float32(layers * THICKNESS), np.float32(0.0))
    for x, y, up in bumps:
        top = np.array([x, y, layers * THICKNESS + up])
        height[np.linalg.norm(HERE - VIEW.shadow_on_table(top), axis=2) < 0.015] = top[2]
    return height, mask


def looked_at(height: np.ndarray, mask: np.ndarray, layers: int = 4) -> HighPlaces:
    return find_high_places(height, mask, VIEW, sheet(layers), THICKNESS, 0.007)


def found(height: np.ndarray, mask: np.ndarray, layers: int = 4) -> tuple[np.ndarray, np.ndarray]:
    seen = looked_at(height, mask, layers)
    return seen.places, seen.above


@pytest.mark.parametrize("place", [(0.52, -0.18), (0.60, 0.0), (0.68, 0.17)])
@pytest.mark.parametrize("up", [0.012, 0.03])
def test_a_bump_is_found_at_its_place(place: tuple[float, float], up: float) -> None:
    places, above = found(*seen([(*place, up)]))
    top = above > 0.8 * up
    assert np.allclose(places[top].mean(axis=0), place, atol=0.003)
    assert above.max() == pytest.approx(up, abs=0.001)
    assert np.linalg.norm(places - place, axis=1).max() < 0.035, (
        "places around the bump are included because heights are blurred"
    )


@pytest.mark.parametrize("width", [1, 2])
def test_heights_at_the_rim_are_ignored(width: int) -> None:
    """At the rim the depth is a mixture of the cloth and of the table or a hand."""
    height, mask = seen([(0.60, 0.0, 0.03)])
    within = cv2.erode(mask.astype(np.uint8), np.ones((2 * width + 1, 2 * width + 1), np.uint8)) > 0
    alone = len(found(height, mask)[0])
    height[mask & ~within] = 0.05
    places = found(height, mask)[0]
    assert alone > 0 and np.linalg.norm(places - (0.60, 0.0), axis=1).max() < 0.035
    height[within] = 4 * THICKNESS
    assert len(found(height, mask)[0]) == 0


def test_unseen_pixels_are_ignored() -> None:
    """Every second pixel of a bump has no depth and is left out of the mean over neighbours."""
    height, mask = seen([(0.60, 0.0, 0.03)])
    whole = found(height, mask)[0]
    height[::2, ::2] = height[1::2, 1::2] = np.nan
    half = found(height, mask)[0]
    assert len(half) == pytest.approx(0.5 * len(whole), rel=0.1)
    assert len(found(np.full_like(height, np.nan), mask)[0]) == 0


@pytest.mark.parametrize("hole", [5, 11, 31])
def test_a_hole_in_the_depth_does_not_change_the_edges(hole: int) -> None:
    """The mask shows that there is cloth, so its height is filled from the surroundings."""
    height, mask = seen([])
    row, column = np.round(VIEW.to_pixel(np.array([0.60, 0.05]))).astype(int)[::-1]
    height[row - hole // 2 : row + hole // 2 + 1, column - hole // 2 : column + hole // 2 + 1] = np.nan
    inside = looked_at(height, mask).inside
    assert inside(np.array([0.60, 0.0])) and inside(np.array([0.60, 0.05]))
    assert not inside(np.array([0.60, 0.25 - EDGE + 0.005]))


def test_only_heights_above_the_planned_layers_count() -> None:
    for layers in (2, 4, 6):
        assert len(found(*seen([], layers), layers)[0]) == 0
    places, above = found(*seen([], 6), 2)
    assert len(places) > 1000 and np.allclose(above, 4 * THICKNESS, atol=0.001)


def test_cloth_outside_the_planned_shape_is_not_judged_by_height() -> None:
    """Cloth outside the planned shape is judged by the outline, because its number of layers is unknown."""
    height, mask = seen([])
    flat = sheet(4)
    half = PredictedShape(flat.vertices * (1.0, 0.5, 1.0), flat.triangles, flat.material)
    assert len(find_high_places(height, mask, VIEW, half, THICKNESS, 0.007).places) == 0


def test_places_clear_of_the_edges_are_well_inside_them() -> None:
    inside = looked_at(*seen([])).inside
    near = 0.25 - EDGE
    for place, clear in (
        ((0.60, 0.0), True), ((0.60, near - 0.003), True), ((0.60, near + 0.005), False), ((0.44, 0.0), False),
        ((9.0, 9.0), False), ((0.60, 9.0), False), ((0.60, -9.0), False), ((9.0, 0.0), False),
        ((-9.0, 0.0), False),
    ):  # fmt: skip
        assert inside(np.array(place)) is clear


@pytest.mark.parametrize("width", [0.6, 1.2])
def test_no_point_beyond_the_view_is_inside_the_edges(width: float) -> None:
    """Cloth covers the whole view. Points outside the view are not inside the cloth."""
    height = np.full(VIEW.shape, 4 * THICKNESS, np.float32)
    inside = looked_at(height, np.ones(VIEW.shape, bool)).inside
    (near, far), (right, left) = TABLE.x, TABLE.y
    middle = np.array([0.5 * (near + far), 0.5 * (right + left)])
    assert inside(middle)
    for beyond in ((near - width, middle[1]), (far + width, middle[1]), (middle[0], right - width),
                   (middle[0], left + width)):  # fmt: skip
        assert inside(np.array(beyond)) is False


def test_a_high_place_does_not_move_the_edges_of_the_rest() -> None:
    inside = looked_at(*seen([(0.55, 0.0, 0.15)])).inside
    assert inside(np.array([HIGH[0] - EDGE - 0.006, 0.1]))
    assert not inside(np.array([HIGH[0] - EDGE + 0.006, 0.1]))


def test_the_edge_of_a_high_bulge_is_corrected_for_parallax() -> None:
    """The far part of the stack is a bulge of 40 mm, which hides 28 mm of the table behind it."""
    height, mask = np.zeros(VIEW.shape, np.float32), np.zeros(VIEW.shape, bool)
    for low, up in ((LOW[0], 4 * THICKNESS), (0.69, 0.040)):
        there = on_table(VIEW, up)
        part = np.all((there > [low, LOW[1]]) & (there < HIGH), axis=2)
        height[part], mask[part] = up, True
    inside = looked_at(height, mask).inside
    assert inside(np.array([HIGH[0] - EDGE - 0.006, 0.0]))
    assert not inside(np.array([HIGH[0] - EDGE + 0.004, 0.0]))


def test_upper_layers_that_are_set_back_have_their_own_edge() -> None:
    """The upper two of four layers end 20 mm before the lower two."""
    height, mask = seen([])
    height[mask & (HERE[..., 1] > 0.23)] = 2 * THICKNESS
    rng = np.random.default_rng(3)
    inside = looked_at(height + rng.normal(0.0, 0.001, height.shape).astype(np.float32), mask).inside
    assert inside(np.array([0.60, 0.23 - EDGE - 0.007])) and not inside(np.array([0.60, 0.23 - EDGE + 0.007]))
    assert not inside(np.array([0.60, 0.24]))


@pytest.mark.parametrize("x", [0.55, 0.9])
@pytest.mark.parametrize("thickness", [0.010, 0.020, 0.030])
def test_room_for_fingers_is_corrected_for_parallax(x: float, thickness: float) -> None:
    """The far edge of a thick layer appears up to 23 mm too far away."""
    low, high = np.array([x - 0.3, -0.25]), np.array([x, 0.25])
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    flat = np.column_stack([corners, np.full(4, 0.5 * thickness)])
    there = on_table(VIEW, thickness)
    mask = np.all((there > low) & (there < high), axis=2)
    shape = PredictedShape(flat, np.array([[0, 1, 2], [0, 2, 3]], np.int32), corners)
    inside = find_high_places(
        np.where(mask, np.float32(thickness), 0.0), mask, VIEW, shape, thickness, 0.007
    ).inside
    for corner, inwards in ((low, 1.0), (high, -1.0)):
        for axis in np.eye(2):
            edge = np.where(axis > 0, corner, 0.5 * (low + high))
            assert inside(edge + inwards * (EDGE + 0.006) * axis)
            assert not inside(edge + inwards * (EDGE - 0.004) * axis)
