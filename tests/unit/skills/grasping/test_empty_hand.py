"""A hand closes in the air after the release, to feel whether cloth has stayed between its pads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.grasping.empty_hand import NARROW, Emptied, EmptyCheck, check_empty
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.motion.moves.lift import CAREFUL_SPEED
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP
from tests.hands import SensedHand
from tests.unit.skills.grasping.tared import bias_of

SETTINGS = GRASP
ABOVE, TOP = 0.04, 0.10
"""Height at which the hand closes, and to which it rises [m]."""
RISE, PADS = 0.25, 0.10
"""Speed of the hand, and of its pads [m/s]."""
RELEASED = 0.020
FORCE_TIME = 0.05
"""Time constant of the force on the pads [s]."""


class RisingHand(SensedHand):
    """A hand that has released cloth. Its pads follow commands, and stop at `cloth` [m] between them, which they
    press with `grip` [N]. error: of the measured opening [m]."""

    def __init__(self, seed: int, cloth: float = 0.0, grip: float = 10.0, error: float = 0.0) -> None:
        super().__init__(seed)
        self.bias = bias_of(self)
        self.wait(20.0)
        self.height, self.cloth, self.grip, self.error = 0.0, cloth, grip, error
        self.real, self.goal, self.jammed = RELEASED, RELEASED, False
        self.closed_at: float | None = None
        self.top, self.narrowest, self.speed = TOP, RELEASED, RISE

    def tick(self) -> HandReading:
        self.height = min(self.height + self.speed * 0.01, self.top)
        if not self.jammed:
            self.real += float(np.clip(max(self.goal, self.cloth) - self.real, -PADS * 0.01, PADS * 0.01))
        pressing = self.cloth > 0.0 and self.goal < self.cloth and self.real <= self.cloth
        target = np.full(2, self.grip if pressing else 0.0)
        self.pads = self.pads + (target - self.pads) * (0.01 / FORCE_TIME)
        self.opening, self.narrowest = max(self.real + self.error, 0.0), min(self.narrowest, self.real)
        return self.read()


def rise(hand: RisingHand, layer: float = 0.0008) -> tuple[Outcome[Emptied], float]:
    """Let the hand rise and check that it is empty. Also returns the time from the beginning of closing [s]."""
    state = EmptyCheck(SETTINGS, hand.bias, layer, ABOVE, RELEASED)
    for _ in range(1000):
        command, after = check_empty(hand.tick(), state)
        if command is not None:
            assert hand.height >= ABOVE, "the pads close only above the stack"
            hand.goal = command.opening
            hand.closed_at = hand.closed_at or hand.now
        if isinstance(after, Outcome):
            return after, hand.now - (hand.closed_at or hand.now)
        state = after
    raise AssertionError("the check does not end")


def test_empty_pads_meet_and_open_again_within_the_rise() -> None:
    """40 hands; the rest of the rise takes 0.24 s at full speed, and 0.2 s more to brake."""
    for seed in range(40):
        hand = RisingHand(seed)
        end, seconds = rise(hand)
        assert end.ok and end.unwrap().met
        assert seconds < 0.36 and hand.goal == RELEASED


def test_pads_wait_half_closed_for_a_hand_that_rises_slowly() -> None:
    """Pads that wait are not taken for pads that neither meet nor move."""
    for seed in range(10):
        hand = RisingHand(seed)
        hand.speed = CAREFUL_SPEED
        end, _ = rise(hand)
        assert end.ok and end.unwrap().met


def test_pads_of_a_hand_that_stays_low_do_not_close_on_the_stack() -> None:
    """An arm that hangs, or brakes for the other hand, leaves it there."""
    hand = RisingHand(9)
    hand.top = ABOVE + 0.005
    end, _ = rise(hand)
    assert end.ok and not end.unwrap().met and hand.narrowest >= NARROW


@pytest.mark.parametrize("cloth", [0.0005, 0.0008, 0.0025])
def test_the_lightest_cloth_between_the_pads_is_felt(cloth: float) -> None:
    """Cloth of 0.5 mm is felt even if the garment's file states 0.8 mm. The pads stay closed on it."""
    for seed in range(40):
        hand = RisingHand(seed, cloth)
        end, seconds = rise(hand, layer=max(cloth, 0.0008))
        assert end.failure is not None and end.failure.kind is FailureKind.STUCK_ON_FINGER
        assert end.failure.values["side"] == "left" and hand.goal == 0.0
        assert seconds < 0.5


def test_a_weak_grip_feels_cloth_too() -> None:
    end, _ = rise(RisingHand(3, cloth=0.0008, grip=3.0))
    assert end.failure is not None


def test_pads_whose_opening_is_measured_wrong_raise_no_alarm() -> None:
    """Empty pads that seem to be 3 mm apart feel no force."""
    end, seconds = rise(RisingHand(4, error=0.003))
    assert end.ok and not end.unwrap().met and seconds < 0.6


def test_saturated_pads_raise_no_alarm() -> None:
    hand = RisingHand(5)
    hand.bias = replace(hand.bias, cells=hand.bias.cells - 1.0)
    end, _ = rise(hand)
    assert end.ok and end.unwrap().met


def test_pads_that_do_not_move_end_the_check() -> None:
    hand = RisingHand(6)
    hand.jammed = True
    end, _ = rise(hand)
    assert end.ok and not end.unwrap().met


@pytest.mark.parametrize("spoilt", ["old", "nan"])
def test_readings_that_cannot_be_used_are_passed_over(spoilt: str) -> None:
    hand, commands = RisingHand(7), []
    state = EmptyCheck(SETTINGS, hand.bias, 0.0008, ABOVE, RELEASED)
    for _ in range(1000):
        reading = hand.tick()
        late = replace(reading.gripper, stamp=reading.stamp - 9.0)
        unclear = replace(reading.gripper, opening=np.nan)
        command, after = check_empty(replace(reading, gripper=late if spoilt == "old" else unclear), state)
        commands += [command.opening] if command else []
        if isinstance(after, Outcome):
            break
        state = after
    assert isinstance(after, Outcome) and not after.unwrap().met and commands[-1] == RELEASED


def test_a_hand_whose_height_is_unknown_does_not_close() -> None:
    hand = RisingHand(8)
    state = EmptyCheck(SETTINGS, hand.bias, 0.0008, ABOVE, RELEASED)
    command, after = check_empty(replace(hand.tick(), height=np.nan), state)
    assert command is None and after is state
