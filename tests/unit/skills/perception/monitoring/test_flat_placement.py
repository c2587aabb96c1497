"""The place of a flat garment, from a silhouette of which a part is folded over or displaced."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.robots.ports import Array
from foldcell.skills.perception.monitoring.flat_placement import convex_corners, place_outline
from foldcell.skills.perception.outline import resample_closed
from tests.scenes import place

TOWEL = np.array([[0.40, -0.30], [0.80, -0.30], [0.80, 0.30], [0.40, 0.30]])


def turned(points: Array, angle: float, shift: tuple[float, float]) -> Array:
    middle = TOWEL.mean(axis=0)
    return place(points - middle, *(middle + shift), angle)


def test_the_corners_of_a_rectangle_point_inwards() -> None:
    corners = convex_corners(resample_closed(TOWEL[::-1], 0.004))
    assert len(corners) == 4
    for corner in corners:
        assert np.linalg.norm(TOWEL - corner.point, axis=1).min() < 0.005
        assert corner.inward @ (TOWEL.mean(axis=0) - corner.point) > 0.0


def test_a_notch_and_a_slight_bend_are_no_corners() -> None:
    bent = np.array([[0.4, -0.3], [0.6, -0.33], [0.8, -0.3], [0.8, 0.3], [0.6, 0.1], [0.4, 0.3]])
    found = np.array([c.point for c in convex_corners(resample_closed(bent, 0.003))])
    assert len(found) == 4
    assert np.abs(found[:, 0] - 0.6).min() > 0.15


@pytest.mark.parametrize(("angle", "shift"), [(0.0, (0.0, 0.0)), (0.3, (0.05, -0.12)), (-0.5, (-0.03, 0.15))])
def test_the_parts_that_lie_flat_show_where_the_garment_belongs(angle: float, shift: tuple[float, float]) -> None:
    """The corner at (0.80, 0.30) is folded over the towel."""
    seen = turned(np.array([[0.40, -0.30], [0.80, -0.30], [0.80, 0.12], [0.55, 0.30], [0.40, 0.30]]), angle, shift)
    contour = resample_closed(seen, 0.004)
    placed = place_outline(contour, convex_corners(contour), TOWEL, convex_corners(TOWEL))
    assert placed.of(TOWEL) == pytest.approx(turned(TOWEL, angle, shift), abs=0.012)
    assert placed.share > 0.7


def test_a_heap_without_a_flat_part_belongs_where_the_garment_lay() -> None:
    heap = np.array([0.6, 0.05]) + 0.1 * np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 60)])
    placed = place_outline(heap, convex_corners(heap), TOWEL, convex_corners(TOWEL))
    assert placed.of(TOWEL) == pytest.approx(TOWEL) and placed.share == 0.0
