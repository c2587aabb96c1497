"""A hand closes in the air after the release, to feel whether cloth has stayed between its pads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.skills.grasping.empty_hand import MET, OPENED, EmptyCheck, check_empty
from foldcell.skills.grasping.hand_reading import HandReading
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP
from tests.hands import SensedHand
from tests.unit.skills.grasping.tared import bias_of

SETTINGS = GRASP
PADS = 0.10
"""Speed of the pads [m/s]."""
RELEASED = 0.020
FORCE_TIME = 0.05
"""Time constant of the force on the pads [s]."""


class OpenHand(SensedHand):
    """A hand that has released cloth. Its pads follow commands, and stop at `cloth` [m] between them, which they
    press with `grip` [N]. error: of the measured opening [m]."""

    def __init__(self, seed: int, cloth: float = 0.0, grip: float = 10.0, error: float = 0.0) -> None:
        super().__init__(seed)
        self.bias = bias_of(self)
        self.wait(20.0)
        self.height, self.cloth, self.grip, self.error = 0.05, cloth, grip, error
        self.real, self.goal, self.jammed = RELEASED, RELEASED, False

    def tick(self) -> HandReading:
        if not self.jammed:
            self.real += float(np.clip(max(self.goal, self.cloth) - self.real, -PADS * 0.01, PADS * 0.01))
        pressing = self.cloth > 0.0 and self.goal < self.cloth and self.real <= self.cloth
        target = np.full(2, self.grip if pressing else 0.0)
        self.pads = self.pads + (target - self.pads) * (0.01 / FORCE_TIME)
        self.opening = max(self.real + self.error, 0.0)
        return self.read()


def check(hand: OpenHand, layer: float = 0.0008) -> tuple[Outcome[float], float]:
    """Check that the hand is empty. Also returns the time that it takes [s]."""
    began = hand.now
    state = EmptyCheck(SETTINGS, hand.bias, layer, RELEASED, began)
    for _ in range(1000):
        command, after = check_empty(hand.tick(), state)
        hand.goal = command.opening
        if isinstance(after, Outcome):
            return after, hand.now - began
        state = after
    raise AssertionError("the check does not end")


def test_empty_pads_meet_and_open_again() -> None:
    """40 hands. The pads need 0.2 s to meet, and 0.1 s to be so far apart that they hold no cloth."""
    for seed in range(40):
        hand = OpenHand(seed)
        end, seconds = check(hand)
        assert end.ok and end.unwrap() < MET * 0.0008
        assert seconds < 0.42 and hand.goal == RELEASED and hand.real >= OPENED - 0.0005


@pytest.mark.parametrize("cloth", [0.0005, 0.0008, 0.0025])
def test_the_lightest_cloth_between_the_pads_is_felt(cloth: float) -> None:
    """Cloth of 0.5 mm is felt even if the garment's file states 0.8 mm. The pads stay closed on it."""
    for seed in range(40):
        hand = OpenHand(seed, cloth)
        end, seconds = check(hand, layer=max(cloth, 0.0008))
        assert end.failure is not None and end.failure.kind is FailureKind.STUCK_ON_FINGER
        assert end.failure.values["side"] == "left" and hand.goal == 0.0
        assert seconds < 0.5


def test_a_weak_grip_feels_cloth_too() -> None:
    end, _ = check(OpenHand(3, cloth=0.0008, grip=3.0))
    assert end.failure is not None


def test_pads_whose_opening_is_measured_wrong_raise_no_alarm() -> None:
    """Empty pads that seem to be 3 mm apart feel no force."""
    end, seconds = check(OpenHand(4, error=0.003))
    assert end.ok and end.unwrap() > 0.002 and seconds < 0.6


def test_saturated_pads_raise_no_alarm() -> None:
    hand = OpenHand(5)
    hand.bias = replace(hand.bias, cells=hand.bias.cells - 1.0)
    end, _ = check(hand)
    assert end.ok and end.unwrap() < MET * 0.0008


def test_pads_that_do_not_move_end_the_check() -> None:
    hand = OpenHand(6)
    hand.jammed = True
    end, _ = check(hand)
    assert end.ok and end.unwrap() == pytest.approx(RELEASED - SETTINGS.empty_opening, abs=0.0005)
    assert hand.goal == RELEASED


@pytest.mark.parametrize("spoilt", ["old", "nan"])
def test_readings_that_cannot_be_used_are_passed_over(spoilt: str) -> None:
    hand, commands = OpenHand(7), []
    state = EmptyCheck(SETTINGS, hand.bias, 0.0008, RELEASED, hand.now)
    for _ in range(1000):
        reading = hand.tick()
        late = replace(reading.gripper, stamp=reading.stamp - 9.0)
        unclear = replace(reading.gripper, opening=np.nan)
        command, after = check_empty(replace(reading, gripper=late if spoilt == "old" else unclear), state)
        commands.append(command.opening)
        if isinstance(after, Outcome):
            break
        state = after
    assert isinstance(after, Outcome) and np.isnan(after.unwrap()) and commands[-1] == RELEASED
