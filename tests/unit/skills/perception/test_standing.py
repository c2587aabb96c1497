"""What stands above a flat stack is found where it stands, though the camera looks at it aslant."""

from __future__ import annotations

import numpy as np
import pytest

from skills.perception.standing import EDGE, Standing, standing
from skills.perception.view import TableView
from skills.vocabulary import PredictedShape
from tests.scenes import TABLE, camera

VIEW = TableView(camera(), TABLE)
THICKNESS = 0.002
LOW, HIGH = np.array([0.45, -0.25]), np.array([0.75, 0.25])


def sheet(layers: int) -> PredictedShape:
    """A rectangle of so many layers lying flat, vertices in the middle of the upper one."""
    corners = np.array([[LOW[0], LOW[1]], [HIGH[0], LOW[1]], [HIGH[0], HIGH[1]], [LOW[0], HIGH[1]]])
    z = np.full((4, 1), (layers - 0.5) * THICKNESS)
    return PredictedShape(np.hstack([corners, z]), np.array([[0, 1, 2], [0, 2, 3]], np.int32), corners)


def seen(bumps: list[tuple[float, float, float]], layers: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Height and mask of the stack with round bumps (x, y, height), 15 mm in radius, as the camera sees them."""
    height, mask = np.zeros(VIEW.shape, np.float32), np.zeros(VIEW.shape, bool)
    rows, columns = np.mgrid[: VIEW.shape[0], : VIEW.shape[1]]
    on_table = VIEW.to_table(np.dstack([columns, rows]))
    mask[:] = np.all((on_table > LOW) & (on_table < HIGH), axis=2)
    height[mask] = layers * THICKNESS
    for x, y, up in bumps:
        top = np.array([x, y, layers * THICKNESS + up])
        near = np.linalg.norm(on_table - VIEW.shadow_on_table(top), axis=2) < 0.015
        height[near] = top[2]
    return height, mask


def looked_at(height: np.ndarray, mask: np.ndarray, layers: int = 4) -> Standing:
    return standing(height, mask, VIEW, sheet(layers), THICKNESS, 0.007)


def found(height: np.ndarray, mask: np.ndarray, layers: int = 4) -> tuple[np.ndarray, np.ndarray]:
    seen = looked_at(height, mask, layers)
    return seen.places, seen.above


@pytest.mark.parametrize("place", [(0.52, -0.18), (0.60, 0.0), (0.68, 0.17)])
@pytest.mark.parametrize("up", [0.012, 0.03])
def test_a_bump_is_found_where_it_stands(place: tuple[float, float], up: float) -> None:
    places, above = found(*seen([(*place, up)]))
    top = above > 0.8 * up
    assert np.allclose(places[top].mean(axis=0), place, atol=0.003)
    assert above.max() == pytest.approx(up, abs=0.001)
    assert np.linalg.norm(places - place, axis=1).max() < 0.035, "its foot is blurred"


def test_what_was_not_seen_or_lies_at_the_rim_does_not_count() -> None:
    height, mask = seen([(0.60, 0.0, 0.03)])
    first = np.nonzero(mask)[0].min()
    height[first : first + 2] = 0.2  # the table's depth and the cloth's are mixed there
    height[height == height[mask].max()] = np.nan
    height[height > 0.02] = np.nan
    assert len(found(height, mask)[0]) == 0


def test_only_what_is_more_than_the_plans_layers_counts() -> None:
    for layers in (2, 4, 6):
        assert len(found(*seen([], layers), layers)[0]) == 0
    places, above = found(*seen([], 6), 2)
    assert len(places) > 1000 and np.allclose(above, 4 * THICKNESS, atol=0.001)


def test_what_is_clear_of_the_edges_lies_well_inside_them() -> None:
    inside = looked_at(*seen([])).inside
    near = 0.25 - EDGE
    for place, clear in (
        ((0.60, 0.0), True), ((0.60, near - 0.003), True), ((0.60, near + 0.005), False), ((0.44, 0.0), False),
        ((9.0, 9.0), False),
    ):  # fmt: skip
        assert inside(np.array(place)) is clear


def test_upper_layers_that_are_set_back_have_an_edge_of_their_own() -> None:
    """Of four layers the upper two end 20 mm before the lower two."""
    height, mask = seen([])
    rows, columns = np.mgrid[: VIEW.shape[0], : VIEW.shape[1]]
    y = VIEW.to_table(np.dstack([columns, rows]))[..., 1]
    height[mask & (y > 0.23)] = 2 * THICKNESS
    rng = np.random.default_rng(3)
    inside = looked_at(height + rng.normal(0.0, 0.001, height.shape).astype(np.float32), mask).inside
    assert inside(np.array([0.60, 0.23 - EDGE - 0.007])) and not inside(np.array([0.60, 0.23 - EDGE + 0.007]))
    assert not inside(np.array([0.60, 0.24]))


@pytest.mark.parametrize("x", [0.55, 0.9])
@pytest.mark.parametrize("thickness", [0.010, 0.020, 0.030])
def test_room_is_measured_where_the_cloth_is_and_not_where_it_appears(x: float, thickness: float) -> None:
    """A thick layer whose far edge lies at x appears up to 23 mm further away than it is."""
    low, high = np.array([x - 0.3, -0.25]), np.array([x, 0.25])
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    flat = np.column_stack([corners, np.full(4, 0.5 * thickness)])
    rows, columns = np.mgrid[: VIEW.shape[0], : VIEW.shape[1]]
    there = VIEW.to_table(np.dstack([columns, rows]), thickness)
    mask = np.all((there > low) & (there < high), axis=2)
    shape = PredictedShape(flat, np.array([[0, 1, 2], [0, 2, 3]], np.int32), corners)
    inside = standing(np.where(mask, np.float32(thickness), 0.0), mask, VIEW, shape, thickness, 0.007).inside
    for corner, inwards in ((low, 1.0), (high, -1.0)):
        for axis in np.eye(2):
            edge = np.where(axis > 0, corner, 0.5 * (low + high))
            assert inside(edge + inwards * (EDGE + 0.006) * axis)
            assert not inside(edge + inwards * (EDGE - 0.004) * axis)
