"""Pulls that spread a garment: which corners are taken, and where they are pulled."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Array
from foldcell.skills.fold_plan.spreading import (
    HEIGHT,
    INSET,
    LONGEST,
    MARGIN,
    Pull,
    lies_on,
    plan_pulls,
    pulls_home,
    spread_arcs,
    spread_step,
)
from foldcell.skills.perception.monitoring.flat_placement import convex_corners
from foldcell.skills.perception.outline import resample_closed
from foldcell.skills.vocabulary import Corner, GraspId, Table

TABLE = Table(-0.1, (0.20, 1.10), (-0.75, 0.75))
FLAT = np.array([[0.40, -0.30], [0.80, -0.30], [0.80, 0.30], [0.40, 0.30]])
PLACES = convex_corners(FLAT)
THICKNESS = 0.0025
on_table = partial(lies_on, TABLE)


def corners(*points: tuple[float, float]) -> tuple[Corner, ...]:
    """The convex corners of an outline, counter-clockwise."""
    return convex_corners(np.array(points))


def outline_of(found: tuple[Corner, ...]) -> Array:
    return np.array([corner.point for corner in found])


def anywhere(point: Array) -> bool:
    return True


def tips(pull: Pull, corner: tuple[float, float]) -> bool:
    return bool(np.linalg.norm(pull.grasp - corner) < INSET + 0.002)


def test_the_corner_that_left_its_place_is_pulled_back_there() -> None:
    drawn_in = corners((0.40, -0.30), (0.80, -0.30), (0.72, 0.20), (0.40, 0.30))
    pull, anchor = plan_pulls(outline_of(drawn_in), drawn_in, FLAT, PLACES, on_table, anywhere).unwrap()
    assert tips(pull, (0.72, 0.20))
    assert np.linalg.norm(pull.target - FLAT[2]) < INSET + 0.002
    assert tips(anchor, (0.40, -0.30)) and anchor.length == 0.0, "the other hand holds the opposite corner"


def test_two_corners_that_left_their_places_are_pulled_at_once_each_to_its_own() -> None:
    rucked = corners((0.40, -0.30), (0.80, -0.30), (0.76, 0.18), (0.43, 0.20))
    pulls = plan_pulls(outline_of(rucked), rucked, FLAT, PLACES, on_table, anywhere).unwrap()
    assert sorted(int(np.linalg.norm(FLAT - p.target, axis=1).argmin()) for p in pulls) == [2, 3]
    assert all(p.length < 0.15 for p in pulls)


def test_no_corner_is_pulled_further_from_the_parts_that_lie_flat_than_the_cloth_is_long() -> None:
    """(0.83, 0.36) is further from (0.40, -0.30) than any place of the towel: it is not its corner."""
    wide = corners((0.40, -0.30), (0.80, -0.30), (0.86, 0.42), (0.40, 0.30))
    outcome = plan_pulls(outline_of(wide), wide, FLAT, PLACES, on_table, anywhere)
    assert outcome.failure is not None and "within reach" in outcome.failure.what


def test_no_corner_is_pushed_into_the_garment() -> None:
    """The garment lies 0.15 m further left than its places: to pull its right corners there would heap it up."""
    beside = corners((0.40, -0.15), (0.80, -0.15), (0.75, 0.40), (0.45, 0.40))
    for fruitless in range(4):
        outcome = plan_pulls(outline_of(beside), beside, FLAT, PLACES, on_table, anywhere, fruitless)
        for pull in outcome.value or ():
            assert not pull.length or (pull.target - pull.grasp) @ (pull.grasp - [0.6, 0.1]) > 0.0


def test_after_a_pull_in_vain_another_is_tried_until_none_is_left() -> None:
    rucked = corners((0.40, -0.30), (0.80, -0.30), (0.76, 0.18), (0.43, 0.20))
    planned = [plan_pulls(outline_of(rucked), rucked, FLAT, PLACES, on_table, anywhere, n).value for n in range(4)]
    first, *others, none = planned
    assert first and all(others) and none is None
    assert [sum(pull.length > 0.0 for pull in pulls or ()) for pulls in planned] == [2, 1, 1, 0]
    assert len({tuple(np.round([p.grasp[0], *p.target], 3)) for pulls in others for p in (pulls or ())[:1]}) == 2


def test_a_pull_towards_the_edge_of_the_table_ends_before_the_heap_could_come_to_it() -> None:
    on_near = partial(lies_on, Table(-0.1, (0.29, 1.10), (-0.75, 0.75)))
    drawn_in = corners((0.39, -0.30), (0.80, -0.30), (0.80, 0.30), (0.52, 0.30))
    pull, _ = plan_pulls(outline_of(drawn_in), drawn_in, FLAT, PLACES, on_table, anywhere).unwrap()
    short, _ = plan_pulls(outline_of(drawn_in), drawn_in, FLAT, PLACES, on_near, anywhere).unwrap()
    assert short.length < pull.length - 0.05
    assert (outline_of(drawn_in) + (short.target - short.grasp))[:, 0].min() == pytest.approx(0.34)


def test_a_corner_that_lies_on_the_garment_is_unfolded_over_its_crease() -> None:
    folded = np.array([[0.40, -0.30], [0.80, -0.30], [0.80, 0.16], [0.70, 0.30], [0.40, 0.30]])
    contour = resample_closed(folded, 0.004)
    (pull,) = plan_pulls(contour, convex_corners(contour), FLAT, PLACES, on_table, anywhere).unwrap()
    crease = (folded[3] - folded[2]) / np.linalg.norm(folded[3] - folded[2])
    mirrored = 2.0 * (folded[2] + (FLAT[2] - folded[2]) @ crease * crease) - FLAT[2]
    assert pull.upper and tips(pull, tuple(mirrored)) and np.linalg.norm(pull.target - FLAT[2]) < INSET + 0.002
    (grasp,) = spread_step("half", 0, (pull,), THICKNESS).grasps.values()
    assert grasp.layers == 1 and not grasp.whole_stack(THICKNESS), "the garment under the corner stays where it is"


def test_a_ruck_between_corners_that_lie_in_place_is_pulled_out_at_the_boundary() -> None:
    rucked = np.vstack([FLAT[:1], [[0.45, -0.30], [0.60, -0.27], [0.75, -0.30]], FLAT[1:]])
    contour, flat = resample_closed(rucked, 0.004), resample_closed(FLAT, 0.004)
    pull, anchor = plan_pulls(contour, convex_corners(FLAT), flat, PLACES, on_table, anywhere).unwrap()
    assert pull.grasp == pytest.approx([0.60, -0.27 + INSET], abs=0.012)
    assert pull.target - pull.grasp == pytest.approx([0.0, -0.03], abs=0.015)
    assert anchor.length == 0.0 and anchor.grasp[1] > 0.2, "the other hand holds the garment behind the ruck"


@pytest.mark.parametrize(
    ("outline", "takeable", "why"),
    [
        (FLAT, True, "every corner lies in its place"),
        (np.vstack([FLAT[:2], [[0.80, 0.10], [0.55, 0.10], [0.40, 0.30]]]), False, "no hand can take"),
        (np.array([[0.60, 0.0], [0.64, 0.0], [0.60, 0.04]]), True, "it would reach over the table's edge"),
    ],
)
def test_a_heap_that_cannot_be_spread_says_why(outline: Array, takeable: bool, why: str) -> None:
    found = convex_corners(outline)
    places = (
        tuple(Corner(c.point + np.array([0.45, 0.0]), c.inward) for c in PLACES)
        if why.startswith("it would reach")
        else PLACES
    )
    outcome = plan_pulls(outline, found, FLAT, places, on_table, lambda point: takeable)
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.HEAPED
    assert why in outcome.failure.what and "lay the garment flat" in outcome.failure.hint


offset = st.tuples(st.floats(-0.25, 0.25), st.floats(-0.25, 0.25))


@settings(max_examples=60)
@given(st.lists(offset, min_size=4, max_size=4), offset)
def test_no_pull_leaves_the_table_or_is_longer_than_allowed(
    moved: list[tuple[float, float]], shift: tuple[float, float]
) -> None:
    places = tuple(Corner(c.point + np.array(shift), c.inward) for c in PLACES)
    found = convex_corners(FLAT + np.array(moved))
    contour = FLAT + np.array(moved)
    outcome = plan_pulls(contour, found, FLAT + np.array(shift), places, on_table, anywhere)
    if outcome.failure is not None:
        return
    pulls = outcome.unwrap()
    assert 1 <= len(pulls) <= 2
    for pull in pulls:
        assert pull.length <= LONGEST + 2.0 * INSET
        dragged = contour + (pull.target - pull.grasp) if pull.length else ()  # a hand that holds drags nothing
        for x, y in (pull.grasp, pull.target, *dragged, *(p.point for p in places)):
            assert TABLE.x[0] + MARGIN <= x <= TABLE.x[1] - MARGIN
            assert TABLE.y[0] + MARGIN <= y <= TABLE.y[1] - MARGIN
    step = spread_step("half", 0, pulls, THICKNESS)
    assert all(arc[:, 2].max() <= HEIGHT for arc in spread_arcs(step).values())


def test_a_flat_garment_is_drawn_home_by_the_edge_that_leads() -> None:
    moved = np.array([0.0, 0.10])
    here = tuple(Corner(c.point + moved, c.inward) for c in PLACES)
    pulls = pulls_home(here, PLACES, on_table).unwrap()
    assert {tuple(np.round(p.target - p.grasp, 3)) for p in pulls} == {(0.0, -0.1)}
    assert all(p.grasp[1] < 0.0 for p in pulls), "the edge at the right leads to the right"
    far = tuple(Corner(c.point + np.array([0.0, 2.0 * LONGEST]), c.inward) for c in PLACES)
    assert pulls_home(far, PLACES, on_table).failure is not None


def test_a_pull_is_a_fold_step_of_whole_stacks_with_the_line_across() -> None:
    pulls = (Pull(np.array([0.5, -0.2]), np.array([0.5, -0.3])), Pull(np.array([0.5, 0.2]), np.array([0.6, 0.2])))
    step = spread_step("half", 0, pulls, THICKNESS)
    assert step.name == "spread half" and step.grasps.keys() == {GraspId.LEFT, GraspId.RIGHT}
    assert step.grasps[GraspId.LEFT].point == pytest.approx([0.5, 0.2]), "the left hand takes the left corner"
    assert np.sin(step.grasps[GraspId.RIGHT].heading) == pytest.approx(0.0, abs=1e-9)
    assert abs(np.sin(step.grasps[GraspId.LEFT].heading)) == pytest.approx(1.0)
    assert all(grasp.whole_stack(THICKNESS) for grasp in step.grasps.values())
    for grasp_id, arc in spread_arcs(step).items():
        assert arc[0] == pytest.approx([*step.grasps[grasp_id].point, 0.0])
        assert arc[-1] == pytest.approx(step.targets[grasp_id])
    (alone,) = spread_step("half", 0, pulls[:1], THICKNESS).grasps
    assert alone is GraspId.RIGHT
