"""Where hands press, and the way they take: what stands high is pressed, and nothing is swept or driven in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.ports import Side
from skills.planning.pressing import MOST, PRESSED, Dab, choose_dabs, press_paths, within_reach
from skills.vocabulary import Array, FoldLine, ToolPath

LINE = FoldLine(np.array([0.6, -0.2]), np.array([1.0, 0.0]))  # a crease along x, cloth on its right
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


away = st.tuples(st.floats(0.4, 0.8), st.floats(-0.5, -0.27), st.floats(0.008, 0.04))
"""What is high beyond the crease: x, y and by how much."""


@settings(max_examples=40, deadline=None)
@given(st.lists(away, min_size=1, max_size=60))
def test_what_stands_high_is_pressed_or_the_dabs_are_used_up(cloth: list[tuple[float, float, float]]) -> None:
    found = np.array(cloth)
    places, above = found[:, :2], found[:, 2]
    dabs = choose_dabs(places, above, LINE, level, everywhere)
    tips = np.concatenate([fingers(dab) for dab in dabs])
    near = np.linalg.norm(places[:, None] - tips[None], axis=2).min(axis=1) < PRESSED
    assert near.all() or len(dabs) == MOST
    assert near[int(above.argmax())], "the highest first of all"
    assert [dab.high for dab in dabs] == sorted((dab.high for dab in dabs), reverse=True)
    if not near.all():
        assert above[~near].max() <= min(dab.high for dab in dabs), "what is left is lower than what was pressed"


def ridge(low: float, high: float, beside: float = 0.02) -> Array:
    """Places along the crease, so far beside it."""
    x = np.linspace(low, high, 80)
    return np.column_stack([x, np.full_like(x, -0.2 - beside)])


def test_a_crease_is_pressed_evenly_beside_its_line_wherever_on_its_bulge_the_top_is() -> None:
    for beside in (0.005, 0.02, 0.05):
        dabs = choose_dabs(ridge(0.45, 0.75, beside), np.linspace(0.01, 0.03, 80), LINE, level, everywhere)
        x = np.array([dab.point[0] for dab in dabs])
        assert np.diff(x).max() < 0.046 and x[0] < 0.46 and x[-1] > 0.74
        tips = np.array([fingers(dab) for dab in dabs])
        assert np.allclose(np.sort(tips[..., 1], axis=1), [-0.248, -0.21]), "10 and 48 mm from the line"


def test_only_the_part_of_a_crease_that_stands_high_is_pressed() -> None:
    places = np.vstack([ridge(0.45, 0.50), ridge(0.70, 0.75)])
    dabs = choose_dabs(places, np.full(len(places), 0.02), LINE, level, everywhere)
    assert all(dab.point[0] < 0.52 or dab.point[0] > 0.68 for dab in dabs)


def test_no_finger_comes_down_beside_an_edge() -> None:
    """Cloth ends at x = 0.75; 16 mm from there on a finger would turn the hem up."""

    def clear(place: Array) -> bool:
        return bool(place[0] < 0.75 - 0.016)

    places = np.vstack([ridge(0.45, 0.749), [[0.745, -0.4], [0.73, -0.45], [0.5, -0.4]]])
    dabs = choose_dabs(places, np.full(len(places), 0.02), LINE, level, clear)
    tips = np.concatenate([fingers(dab) for dab in dabs])
    assert tips[:, 0].max() < 0.75 - 0.016
    crease = [dab.point[0] for dab in dabs if dab.point[1] > -0.27]
    assert max(crease) > 0.72, "and the crease is pressed as far as that allows"
    assert any(np.allclose(finger, [0.5, -0.4]) for finger in tips)


def test_the_second_finger_goes_where_cloth_stands_too() -> None:
    places = np.array([[0.6, -0.31], [0.6, -0.348]])  # 38 mm apart across the crease
    dabs = choose_dabs(places, np.array([0.03, 0.02]), LINE, level, everywhere)
    assert len(dabs) == 1
    assert np.allclose(sorted(fingers(dabs[0])[:, 1]), [-0.348, -0.31])


def test_tips_go_down_to_the_thicker_of_the_two_stacks() -> None:
    """A finger beside the fold may have fewer layers under it: the hand stays above both."""
    places, above = np.array([[0.6, -0.31]]), np.array([0.03])
    dabs = choose_dabs(places, above, LINE, lambda place: 0.012 if place[1] > -0.32 else 0.006, everywhere)
    assert dabs[0].bottom == 0.012


def test_nothing_that_stands_high_is_nothing_to_press() -> None:
    assert choose_dabs(np.zeros((0, 2)), np.zeros(0), LINE, level, everywhere) == ()
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
        assert np.linalg.norm(step / np.diff(path.t)[:, None], axis=1).max() < 0.32, "gentle"
    pressed = sorted(y for path in paths.values() for y in at_the_bottom(path))
    assert np.allclose(np.unique(np.round(pressed, 6)), sorted(ys)), "every dab is made"


def at_the_bottom(path: ToolPath) -> list[float]:
    """y of the places where the tips are down."""
    low = path.position[:, 2] < 0.0121
    return np.unique(np.round(path.position[low, 1], 6)).tolist()


def test_a_wide_fold_is_shared_by_hands_that_go_the_same_way() -> None:
    paths = press_paths(LINE, dabs_at(-0.40, -0.25, -0.10, 0.15, 0.30, 0.45), HIGHEST)
    left, right = paths[Side.LEFT], paths[Side.RIGHT]
    assert np.array_equal(left.t, right.t)
    assert (left.position[:, 1] - right.position[:, 1]).min() > 0.5
    assert (left.position[-1, 1] > left.position[0, 1]) and (right.position[-1, 1] > right.position[0, 1])


def test_a_narrow_one_is_made_by_the_hand_of_its_side() -> None:
    assert set(press_paths(LINE, dabs_at(-0.3, -0.1), HIGHEST)) == {Side.RIGHT}
    assert set(press_paths(LINE, dabs_at(0.3, 0.1), HIGHEST)) == {Side.LEFT}


def test_fingers_lie_across_the_crease() -> None:
    diagonal = FoldLine(np.array([0.6, 0.0]), np.array([1.0, 1.0]) / np.sqrt(2.0))
    path = press_paths(diagonal, dabs_at(0.1), HIGHEST)[Side.LEFT]
    closing = path.rotation[0][:, 1]
    assert abs(closing[:2] @ diagonal.direction) < 1e-9 and abs(closing[2]) < 1e-9


def test_one_hand_alone_makes_those_beside_the_highest() -> None:
    dabs = dabs_at(-0.4, -0.3, 0.3, 0.4)  # the last is the highest
    assert [dab.point[1] for dab in within_reach(dabs)] == [0.3, 0.4]
