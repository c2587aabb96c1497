"""Where and how hands press: high creases are pressed, and no cloth is moved sideways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foldcell.skills.fold_plan.pressing import (
    LONGEST_S,
    MOST,
    Dab,
    crease_dabs,
    press_paths,
    within_reach,
    within_time,
)
from foldcell.skills.vocabulary import Array, FoldLine, GraspId, ToolPath

LINE = FoldLine(np.array([0.6, -0.2]), np.array([1.0, 0.0]))  # a crease along x with the cloth on its right
FINGERS = 0.019
HIGHEST, START, CLEARANCE = 0.045, 0.080, 0.020


def fingers(dab: Dab, line: FoldLine = LINE) -> Array:
    return np.array([dab.point + sign * FINGERS * line.normal for sign in (-1.0, 1.0)])


def dabs_at(*ys: float, bottom: float = 0.012) -> tuple[Dab, ...]:
    return tuple(Dab(np.array([0.6, y]), bottom, 0.02 + 0.001 * i) for i, y in enumerate(ys))


def everywhere(place: Array) -> bool:
    return True


def level(place: Array) -> float:
    return 0.012


def ridge(low: float, high: float, beside: float = 0.02) -> Array:
    """Places along the crease, at the distance `beside` from it [m]."""
    x = np.linspace(low, high, 80)
    return np.column_stack([x, np.full_like(x, -0.2 - beside)])


def test_dabs_are_evenly_spaced_beside_the_line_for_any_top_of_the_bulge() -> None:
    for beside in (0.005, 0.02, 0.05):
        dabs = crease_dabs(ridge(0.45, 0.75, beside), np.linspace(0.01, 0.03, 80), LINE, level, everywhere)
        x = np.array([dab.point[0] for dab in dabs])
        assert np.diff(x).max() < 0.046 and x[0] < 0.46 and x[-1] > 0.74
        tips = np.array([fingers(dab) for dab in dabs])
        assert np.allclose(np.sort(tips[..., 1], axis=1), [-0.248, -0.21]), (
            "the fingers are 10 and 48 mm from the line"
        )


def test_only_the_part_of_a_crease_that_stands_high_is_pressed() -> None:
    places = np.vstack([ridge(0.45, 0.50), ridge(0.70, 0.75)])
    dabs = crease_dabs(places, np.full(len(places), 0.02), LINE, level, everywhere)
    assert all(dab.point[0] < 0.52 or dab.point[0] > 0.68 for dab in dabs)


def test_high_places_away_from_the_crease_are_not_pressed() -> None:
    """Creases of earlier folds end in corners, which fingers would turn up."""
    places = np.vstack([ridge(0.45, 0.75), [[0.5, -0.4], [0.6, -0.27], [0.6, -0.1]]])
    dabs = crease_dabs(places, np.linspace(0.01, 0.05, len(places)), LINE, level, everywhere)
    assert len(dabs) > 3 and all(abs(dab.point[1] + 0.229) < 1e-9 for dab in dabs)
    assert crease_dabs(places[-3:], np.full(3, 0.05), LINE, level, everywhere) == ()


def test_a_long_crease_is_pressed_along_its_whole_length() -> None:
    dabs = crease_dabs(ridge(0.1, 1.1), np.full(80, 0.02), LINE, level, everywhere)
    x = np.array([dab.point[0] for dab in dabs])
    assert len(dabs) == MOST and x[0] < 0.11 and x[-1] > 1.09


def test_no_finger_comes_down_at_an_edge() -> None:
    """The cloth ends at x = 0.75."""

    def clear(place: Array) -> bool:
        return bool(place[0] < 0.715)

    dabs = crease_dabs(ridge(0.45, 0.749), np.full(80, 0.02), LINE, level, clear)
    tips = np.concatenate([fingers(dab) for dab in dabs])
    assert 0.70 < tips[:, 0].max() < 0.715, "the last dab is as near to the edge as allowed"


def test_a_stack_that_is_too_small_for_the_fingers_is_not_pressed() -> None:
    for depth, pressed in ((0.13, False), (0.14, True)):
        dabs = crease_dabs(
            ridge(0.5, 0.7),
            np.full(80, 0.02),
            LINE,
            level,
            lambda place, depth=depth: bool(place[1] > -0.165 - depth),
        )
        assert bool(dabs) is pressed


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0.4, 0.85), st.floats(-0.259, -0.2), st.floats(0.007, 0.05)), max_size=60))
def test_every_high_place_of_the_crease_is_near_a_dab(cloth: list[tuple[float, float, float]]) -> None:
    found = np.array(cloth).reshape(-1, 3)
    dabs = crease_dabs(found[:, :2], found[:, 2], LINE, level, everywhere)
    assert len(dabs) <= MOST
    x = np.array([dab.point[0] for dab in dabs])
    assert all(np.abs(x - place).min() < 0.03 for place in found[:, 0])
    assert np.array_equal(x, np.sort(x)) and (np.diff(x) > 0.02).all()


@pytest.mark.parametrize("length", [0.03, 0.05, 0.08, 0.1, 0.3, 0.49])
def test_a_crease_gets_the_fewest_dabs_without_gaps_above_45_mm(length: float) -> None:
    dabs = crease_dabs(ridge(0.4, 0.4 + length), np.full(80, 0.02), LINE, level, everywhere)
    assert len(dabs) == int(np.ceil(length / 0.045)) + 1


@pytest.mark.parametrize("beside", [0.005, 0.048, 0.055])
@pytest.mark.parametrize("slope", [-0.1, 0.1])
def test_each_dab_has_the_height_of_the_highest_point_of_the_crease_beside_it(beside: float, slope: float) -> None:
    """The whole width of the crease's bulge counts, but no other part of the cloth."""
    places = np.vstack([ridge(0.45, 0.75, beside), [[0.6, -0.3], [0.6, -0.19]]])
    above = np.r_[0.050 + slope * (places[:80, 0] - 0.6), 0.2, 0.2]
    dabs = crease_dabs(places, above, LINE, level, everywhere)
    assert len(dabs) == 8
    for dab in dabs:
        near = np.abs(places[:80, 0] - dab.point[0]) < 0.0225
        assert dab.high == above[:80][near].max()


def test_a_dab_between_distant_high_places_has_no_height() -> None:
    """The high places and the dabs are further apart than a dab is wide."""
    dabs = crease_dabs(
        np.array([[0.1, -0.22], [0.595, -0.22], [1.1, -0.22]]), np.full(3, 0.02), LINE, level, everywhere
    )
    near = [min(abs(dab.point[0] - x) for x in (0.1, 0.595, 1.1)) < 0.0225 for dab in dabs]
    assert [dab.high for dab in dabs] == [0.02 if there else 0.0 for there in near] and not all(near)


def test_no_finger_comes_down_on_an_edge_between_the_line_and_the_room_behind_it() -> None:
    """For x > 0.6 an upper layer ends 48 mm from the line, under the inner finger."""

    def clear(place: Array) -> bool:
        return not (place[0] > 0.6 and abs(place[1] + 0.248) < 0.005)

    dabs = crease_dabs(ridge(0.45, 0.75), np.full(80, 0.02), LINE, level, clear)
    assert dabs and max(dab.point[0] for dab in dabs) <= 0.6
    assert all(clear(tip) for dab in dabs for tip in fingers(dab))


def test_tips_go_down_to_the_thicker_of_the_two_stacks() -> None:
    """One finger may have fewer layers under it, but the hand stays above the thicker stack."""
    dabs = crease_dabs(
        ridge(0.6, 0.61), np.full(80, 0.03), LINE, lambda place: 0.012 if place[1] > -0.22 else 0.006, everywhere
    )
    assert {dab.bottom for dab in dabs} == {0.012}


def test_a_flat_crease_has_no_dabs() -> None:
    assert crease_dabs(np.zeros((0, 2)), np.zeros(0), LINE, level, everywhere) == ()
    assert press_paths(LINE, (), HIGHEST) == {}


@pytest.mark.parametrize("ys", [(-0.2,), (-0.25, -0.2, -0.1), (0.3, -0.3), (0.35, 0.3, 0.1, -0.1, -0.3)])
def test_hands_move_aside_above_all_cloth_and_straight_down(ys: tuple[float, ...]) -> None:
    paths = press_paths(LINE, dabs_at(*ys), HIGHEST)
    for path in paths.values():
        step = np.diff(path.position, axis=0)
        aside = np.linalg.norm(step[:, :2], axis=1) > 1e-9
        assert (np.minimum(path.position[:-1, 2], path.position[1:, 2])[aside] > HIGHEST + CLEARANCE - 1e-9).all()
        assert path.position[:, 2].min() == pytest.approx(0.012)
        assert path.position[0, 2] == pytest.approx(HIGHEST + START)
        assert np.linalg.norm(step / np.diff(path.t)[:, None], axis=1).max() < 0.32, "the hands are slow"
    pressed = sorted(y for path in paths.values() for y in at_the_bottom(path))
    assert np.allclose(np.unique(np.round(pressed, 6)), sorted(ys)), "every dab is made"


@pytest.mark.parametrize("ys", [(-0.2,), (-0.25, -0.2, -0.1), (0.3, -0.3)])
@pytest.mark.parametrize("highest", [0.02, HIGHEST, 0.12])
def test_hands_move_from_rest_to_rest_with_minimum_jerk(ys: tuple[float, ...], highest: float) -> None:
    """Flash and Hogan's law for a distance l in the time T, with u = t / T, is l (10 u^3 - 15 u^4 + 6 u^5). Its
    largest speed is 15 l / 8 T and its largest jerk is 60 l / T^3. Both are within the arms' limits."""
    dabs = dabs_at(*ys)
    for path in press_paths(LINE, dabs, highest).values():
        assert np.diff(path.t).max() < 0.021, "samples are about 20 ms apart"
        own = [dab for dab in dabs if np.isin(dab.point[1], path.position[:, 1])]
        over = [[*dab.point, highest + CLEARANCE] for dab in own]
        low = [[*dab.point, dab.bottom] for dab in own]
        stops = [[*own[0].point, highest + START]]
        stops += [place for up, down in zip(over, low, strict=True) for place in (up, down, down, up)]
        begun = 0.0
        for here, there in zip(np.array(stops)[:-1], np.array(stops)[1:], strict=True):
            way = float(np.linalg.norm(there - here))
            span = max(1.875 * way / 0.3, np.cbrt(60.0 * way / 24.0), 0.25)
            leg = (path.t > begun + 1e-9) & (path.t <= begun + span + 1e-9)
            u = (path.t[leg] - begun) / span
            share = 10 * u**3 - 15 * u**4 + 6 * u**5
            np.testing.assert_allclose(path.position[leg], here + share[:, None] * (there - here), atol=1e-9)
            begun += span
        assert path.t[-1] == pytest.approx(begun) and path.t[0] == 0.0


def at_the_bottom(path: ToolPath) -> list[float]:
    """y of the places where the tips are lowest [m]."""
    low = path.position[:, 2] < 0.0121
    return np.unique(np.round(path.position[low, 1], 6)).tolist()


def test_a_wide_fold_is_shared_by_two_hands_that_move_in_the_same_direction() -> None:
    paths = press_paths(LINE, dabs_at(-0.40, -0.25, -0.10, 0.15, 0.30, 0.45), HIGHEST)
    left, right = paths[GraspId.LEFT], paths[GraspId.RIGHT]
    assert np.array_equal(left.t, right.t)
    assert (left.position[:, 1] - right.position[:, 1]).min() > 0.5
    assert (left.position[-1, 1] > left.position[0, 1]) and (right.position[-1, 1] > right.position[0, 1])


def test_a_narrow_fold_is_pressed_by_the_hand_of_its_side() -> None:
    assert set(press_paths(LINE, dabs_at(-0.3, -0.1), HIGHEST)) == {GraspId.RIGHT}
    assert set(press_paths(LINE, dabs_at(0.3, 0.1), HIGHEST)) == {GraspId.LEFT}


def test_a_fold_in_the_middle_is_pressed_by_the_hand_of_its_larger_side() -> None:
    assert set(press_paths(LINE, dabs_at(-0.2, -0.1, 0.05), HIGHEST)) == {GraspId.RIGHT}
    assert set(press_paths(LINE, dabs_at(0.2, 0.1, -0.05), HIGHEST)) == {GraspId.LEFT}


@pytest.mark.parametrize("angle", [0.0, 45.0, 90.0, 135.0])
def test_press_paths_do_not_depend_on_the_direction_of_the_line(angle: float) -> None:
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    dabs = tuple(Dab(np.array([0.6, 0.1]) + s * direction, 0.012, 0.02) for s in (0.0, 0.1, 0.05))
    ways = [
        press_paths(FoldLine(np.array([0.6, 0.1]), sign * direction), dabs, HIGHEST)[GraspId.LEFT].position
        for sign in (1.0, -1.0)
    ]
    if angle == 0.0:  # along the table's x axis neither end is further left
        assert {tuple(way[0]) for way in ways} == {tuple(way[-1] + [0, 0, START - CLEARANCE]) for way in ways}
    else:
        np.testing.assert_array_equal(*ways)
        assert ways[0][-1, 1] > ways[0][0, 1]


def test_fingers_lie_across_the_crease() -> None:
    diagonal = FoldLine(np.array([0.6, 0.0]), np.array([1.0, 1.0]) / np.sqrt(2.0))
    path = press_paths(diagonal, dabs_at(0.1), HIGHEST)[GraspId.LEFT]
    closing = path.rotation[0][:, 1]
    assert abs(closing[:2] @ diagonal.direction) < 1e-9 and abs(closing[2]) < 1e-9


def test_one_hand_alone_makes_the_dabs_beside_the_highest_one() -> None:
    dabs = dabs_at(-0.4, -0.3, 0.3, 0.4)  # the last dab is the highest
    assert [dab.point[1] for dab in within_reach(dabs)] == [0.3, 0.4]


@pytest.mark.parametrize("highest", [0.03, 0.045, 0.09])
def test_the_hands_make_the_dabs_at_the_highest_cloth_for_which_there_is_time(highest: float) -> None:
    dabs = dabs_at(*np.linspace(-0.1, 0.1, 6))  # each is higher than the one before
    kept = within_time(LINE, dabs, highest)
    assert 2 <= len(kept) <= 3 and kept == dabs[-len(kept) :]
    assert max(path.t[-1] for path in press_paths(LINE, kept, highest).values()) <= LONGEST_S
    more = press_paths(LINE, dabs[-len(kept) - 1 :], highest)
    assert max(path.t[-1] for path in more.values()) > LONGEST_S
    wide = dabs_at(-0.3, -0.2, 0.2, 0.3)
    assert within_time(LINE, wide, highest) == wide, "each of the two hands has two of them"
    assert within_time(LINE, (), highest) == ()
