"""A dead tactile pad is told by its variance, before it is relied on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.grasping.confirm import Confirmation, Expectation, confirm
from foldcell.skills.grasping.live_pads import LIVE_READINGS, ConstantPads, dead_pad, watch_pads
from foldcell.skills.grasping.settings import without_tactile
from foldcell.skills.grasping.slip import SlipWatch, start_slip_watch, watch_slip
from foldcell.skills.grasping.tare import TactileBias, TareState, tare
from foldcell.skills.vocabulary import Failed, Outcome
from tests.builders.shipped_settings import GRASP
from tests.hands import SensedHand

SETTINGS = GRASP


def deadened(reading, pad, value, tips=False):
    """The reading with one dead pad, or one dead fingertip."""
    name = "tip" if tips else "cells"
    values = getattr(reading.tactile, name).copy()
    values[pad] = value
    return replace(reading, tactile=replace(reading.tactile, **{name: values}))


def tared(hand, spoil=lambda reading: reading, settings=SETTINGS) -> Outcome[TactileBias]:
    state: TareState | Outcome[TactileBias] = TareState(settings)
    while isinstance(state, TareState):
        state = tare(spoil(hand.read()), state)
    return state


@pytest.mark.parametrize("pad", [0, 1])
@pytest.mark.parametrize("value", [0.0, -0.03, 25.0])
@pytest.mark.parametrize("tips", [False, True])
def test_a_dead_stuck_or_saturated_pad_is_found_at_the_tare(pad, value, tips):
    for seed in range(5):
        failure = tared(SensedHand(seed), lambda r: deadened(r, pad, value, tips)).failure
        assert failure is not None and failure.kind is FailureKind.TACTILE_FAULT
        assert ("first", "second")[pad] in failure.what and ("fingertip" in failure.what) is tips
        assert "cable" in failure.hint


@pytest.mark.parametrize("scale", [0.2, 1.0, 3.0])
def test_a_live_pad_is_never_taken_for_a_dead_one(scale):
    for seed in range(100):
        assert tared(SensedHand(seed, scale)).ok


def test_coarse_readings_of_a_live_pad_are_alive():
    """A converter with steps of a hundredth of a newton, of the size of the noise."""

    def coarse(reading):
        tactile = reading.tactile
        return replace(reading, tactile=replace(tactile, cells=tactile.cells.round(2), tip=tactile.tip.round(2)))

    for seed in range(50):
        assert tared(SensedHand(seed), coarse).ok


def test_one_dead_cell_does_not_make_a_pad_dead():
    readings = np.random.default_rng(1).normal(0.0, 0.01, (12, 2, 4, 3))
    readings[:, 0, 1, 2] = 0.0
    assert dead_pad(SensedHand(0).read().tactile.side, readings, SETTINGS) is None


def test_a_pad_that_dies_after_the_tare_is_found_before_the_grasp_is_judged():
    """Otherwise the cell would report a missed grasp, and try again lower."""
    hand = SensedHand(1)
    bias = tared(hand).unwrap()
    hand.pads, hand.opening = np.array([12.0, 12.0]), 0.0025
    state: Confirmation | Outcome = Confirmation(SETTINGS, bias, Expectation(0.0025, 1))
    while isinstance(state, Confirmation):
        state = confirm(deadened(hand.read(), 0, 0.0), state)
    assert state.failure is not None and state.failure.kind is FailureKind.TACTILE_FAULT


def test_a_pad_that_freezes_during_the_fold_is_found_within_a_tenth_of_a_second():
    """A pad frozen at the force of a good grip would never show a slip."""
    hand = SensedHand(2)
    bias = tared(hand).unwrap()
    hand.pads, hand.opening = np.array([12.0, 12.0]), 0.0025
    state: Confirmation | Outcome = Confirmation(SETTINGS, bias, Expectation(0.0025, 1))
    while isinstance(state, Confirmation):
        state = confirm(hand.read(), state)
    watch: SlipWatch | Outcome = start_slip_watch(SETTINGS, bias, state.unwrap())
    for _ in range(200):
        watch = watch_slip(hand.read(), watch)
        assert isinstance(watch, SlipWatch)
    frozen, began = hand.read().tactile.cells[1], hand.now
    while isinstance(watch, SlipWatch):
        watch = watch_slip(deadened(hand.read(), 1, frozen), watch)
    assert watch.failure is not None and watch.failure.kind is FailureKind.TACTILE_FAULT
    assert hand.now - began <= 0.01 * LIVE_READINGS + 0.02


def test_a_force_that_stays_is_counted_from_its_last_change():
    """A pad that becomes constant after a change is told as late as one that was constant from the start."""
    for before in (), (1.0, 2.0, 1.5):
        state = ConstantPads()
        with pytest.raises(Failed, match="first"):
            for n, force in enumerate((*before, *[3.0] * (2 * LIVE_READINGS))):
                state = watch_pads(Side.LEFT, np.array([force, 0.1 * (n % 2)]), state, SETTINGS)
        assert n - len(before) == LIVE_READINGS, "repetitions of the force that stays"


def test_hands_without_tactile_sensors_are_not_checked():
    settings = without_tactile(SETTINGS)
    assert tared(SensedHand(0), lambda r: deadened(deadened(r, 0, 0.0), 1, 0.0), settings).ok
