"""The guarded descent: where it stops, its force, and unexpected objects."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.grasping.descend import (
    DESCENT_ACCELERATION,
    LARGEST_LEAD,
    Contact,
    DescentGoal,
    DescentState,
    descend,
    start_descent,
)
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP
from tests.hands import DescendingHand
from tests.unit.skills.grasping.tared import bias_of

SETTINGS = GRASP
TOP = 0.0025
GOAL = DescentGoal(contact=0.0, bottom=-0.008, through=TOP)
SEEDS = range(60)


def lower(hand: DescendingHand, goal: DescentGoal = GOAL, seconds: float = 10.0) -> tuple[Outcome[Contact], float]:
    """Run a descent. Returns the outcome and the duration [s]."""
    state: DescentState | Outcome[Contact] = start_descent(SETTINGS, goal, bias_of(hand), hand.read())
    begun = hand.now
    while not isinstance(state, Outcome):
        assert hand.now - begun < seconds, "the descent ends"
        command, state = descend(hand.read(), state)
        hand.follow(command.height)
    return state, hand.now - begun


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_descent_presses_the_cloth_to_the_table_and_not_harder(scale: float) -> None:
    """In each of 60 descents the tips detect the contact, within 1 mm of the table and with less than 6 N on the
    arm."""
    hands = [DescendingHand(seed, scale, TOP) for seed in SEEDS]
    ends = [lower(hand)[0].unwrap() for hand in hands]
    assert all(end.by == "tip" for end in ends)
    assert max(abs(end.height) for end in ends) < 0.001
    assert max(hand.peak for hand in hands) < 6.0


@pytest.mark.parametrize("table", [-0.005, -0.002, 0.003])
def test_a_table_at_an_unexpected_height_is_found(table: float) -> None:
    """Arms have errors of millimetres, so the contact decides and not the height."""
    for seed in range(40):
        hand = DescendingHand(seed, 1.0, table + TOP, table)
        end, _ = lower(hand)
        assert end.unwrap().by == "tip"
        assert end.unwrap().height == pytest.approx(table, abs=0.001)


@pytest.mark.parametrize("zero", [-1.0, 1.0])
def test_tips_that_do_not_read_zero_without_load_feel_the_table_all_the_same(zero: float) -> None:
    """zero: their reading in the air [N], which the tare has measured. The first touch counts from 0.35 N."""

    class Shifted(DescendingHand):
        def read(self) -> HandReading:
            reading = super().read()
            return replace(reading, tactile=replace(reading.tactile, tip=reading.tactile.tip + zero))

    for seed in range(20):
        hand = Shifted(seed, 1.0, TOP)
        end, _ = lower(hand)
        assert end.unwrap().by == "tip" and abs(end.unwrap().height) < 0.001 and hand.peak < 6.0


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_first_touch_stops_on_top_of_the_cloth(scale: float) -> None:
    goal = DescentGoal(contact=0.010, bottom=-0.005)
    for seed in range(60):
        end, _ = lower(DescendingHand(seed, scale, top=0.010), goal)
        assert 0.0065 < end.unwrap().height < 0.010


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_noise_in_the_air_is_no_touch(scale: float) -> None:
    """Without a contact down to the stop height, every descent is NO_CONTACT. Noise never counts as a contact."""
    for seed in SEEDS:
        hand = DescendingHand(seed, scale, top=-0.05, floor=-0.06)
        end, _ = lower(hand)
        assert end.failure is not None and end.failure.kind is FailureKind.NO_CONTACT
        assert hand.height >= GOAL.bottom - 1e-9 and hand.peak == 0.0


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("weak", [True, False])
def test_joint_efforts_stop_a_hand_with_numb_tips(scale: float, weak: bool) -> None:
    """The arm's lag detects the contact, or the joint efforts of a stiff arm."""
    for seed in range(30):
        hand = DescendingHand(seed, scale, TOP)
        follow = hand.follow

        def numb(height: float, follow=follow, hand=hand) -> None:
            follow(height)
            hand.tip = np.zeros(2)

        hand.follow = numb  # type: ignore[method-assign]
        hand.stiffness = 1500.0 if weak else 8000.0
        end, _ = lower(hand)
        assert end.unwrap().by == ("stall" if weak else "effort") and hand.peak < (15.0 if weak else 30.0)


@pytest.mark.parametrize("delay", [0.1, 0.2, 0.3])
def test_a_lagging_arm_that_catches_up_is_not_stopped(delay: float) -> None:
    """Over a network an arm follows late. Where the descent slows down, the arm is still far behind but moving."""
    for seed in range(20):
        hand = DescendingHand(seed, 1.0, TOP)
        sent = deque([hand.height] * round(100 * delay))

        def late(command: float, hand: DescendingHand = hand, sent: deque[float] = sent) -> None:
            sent.append(command)
            DescendingHand.follow(hand, sent.popleft())

        hand.follow = late  # type: ignore[method-assign]
        end, _ = lower(hand)
        assert end.unwrap().by == "tip" and end.unwrap().height < 0.001


def test_a_contact_far_above_the_garment_is_a_failure() -> None:
    end, _ = lower(DescendingHand(1, top=0.042, floor=0.037))
    assert end.failure is not None and end.failure.kind is FailureKind.IN_COLLISION
    assert end.failure.values["height_m"] == pytest.approx(0.038, abs=0.004)


def test_the_descent_ends_at_the_stop_height_without_a_contact() -> None:
    goal = DescentGoal(contact=0.0, bottom=-0.005, stop=0.006)
    end, _ = lower(DescendingHand(1, top=0.0, floor=-0.01), goal)
    assert end.unwrap().by == "height"
    assert 0.004 < end.unwrap().height <= 0.006


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize(("layers", "held"), [(2, 1), (3, 1), (4, 2), (4, 3)])
def test_a_descent_to_upper_layers_presses_them_flat_and_stops_in_the_lowest_of_them(
    layers: int, held: int, scale: float
) -> None:
    """Several thick layers push as hard as a first touch long before the tips are under them."""
    top, stop = layers * TOP, (layers - held + 0.65) * TOP
    goal = DescentGoal(contact=top, bottom=-0.008, stop=stop, through=top - stop)
    for seed in range(20):
        end = lower(DescendingHand(seed, scale, top), goal)[0].unwrap()
        assert end.by == "height" and (layers - held) * TOP < end.height < (layers - held + 0.75) * TOP


def test_a_descent_to_upper_layers_ends_where_something_hard_lies() -> None:
    goal = DescentGoal(contact=4 * TOP, bottom=-0.008, stop=2.65 * TOP, through=1.35 * TOP)
    end = lower(DescendingHand(1, 1.0, 4.5 * TOP, floor=4 * TOP), goal)[0].unwrap()
    assert end.by == "tip" and end.height > 3.5 * TOP


def test_a_descent_is_fast_in_the_air_and_slow_over_the_cloth() -> None:
    hand = DescendingHand(3, top=TOP)
    state: DescentState | Outcome[Contact] = start_descent(SETTINGS, GOAL, bias_of(hand), hand.read())
    heights, commands = [], []
    while not isinstance(state, Outcome):
        command, state = descend(hand.read(), state)
        hand.follow(command.height)
        heights.append(hand.height)
        commands.append(command.height)
    speed = -np.diff(commands[:-1]) * 100.0
    near = np.array(heights[:-2]) < 0.005
    assert speed.max() == pytest.approx(SETTINGS.approach_speed)
    assert speed[near].max() <= SETTINGS.guarded_speed + 1e-9
    assert np.abs(np.diff(speed)).max() <= DESCENT_ACCELERATION * 0.01 + 1e-9


def test_the_command_stays_near_an_arm_that_does_not_follow() -> None:
    """With a stalled arm, the command stays within the allowed lead and the descent ends. This also holds just
    above the stop height."""
    for height, kind in ((0.05, FailureKind.TRACKING_ERROR), (GOAL.bottom + 0.002, FailureKind.NO_CONTACT)):
        hand = DescendingHand(1)
        state: DescentState | Outcome[Contact] = start_descent(SETTINGS, GOAL, bias_of(hand), hand.read())
        hand.height = height
        for _ in range(1500):
            if isinstance(state, Outcome):
                break
            command, state = descend(hand.read(), state)
            assert command.height >= hand.height - LARGEST_LEAD - 1e-12
        assert isinstance(state, Outcome) and state.failure is not None
        assert state.failure.kind is kind


def test_a_repeated_reading_holds_the_descent_and_is_not_counted() -> None:
    hand = DescendingHand(1)
    state = start_descent(SETTINGS, GOAL, bias_of(hand), hand.read())
    hand.tip = np.array([5.0, 5.0])
    reading = hand.read()
    command, state = descend(reading, state)
    for k in range(8):  # the same reading repeated nine times counts as one touch
        again = replace(reading, stamp=reading.stamp + 0.01 * k)
        held, state = descend(again, state)
        assert held.hold and held.height == command.height
        assert isinstance(state, DescentState) and state.tip_count == 1


def test_stale_or_invalid_readings_end_the_descent() -> None:
    hand = DescendingHand(1)
    state = start_descent(SETTINGS, GOAL, bias_of(hand), hand.read())
    late = replace(hand.read(), stamp=hand.now + 0.2)
    command, end = descend(late, state)
    assert isinstance(end, Outcome) and end.failure is not None
    assert end.failure.kind is FailureKind.STALE_STATE and command.hold
    hand.tip = np.array([np.nan, 0.0])
    command, end = descend(hand.read(), state)
    assert isinstance(end, Outcome) and end.failure is not None
    assert end.failure.kind is FailureKind.TACTILE_FAULT
    assert command.hold and command.height == hand.height


def test_descent_limits_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ValueError, match="bottom"):
        DescentGoal(contact=0.0, bottom=0.01)
    with pytest.raises(ValueError, match="bottom"):
        DescentGoal(contact=0.01, bottom=0.005, stop=0.0)
