"""Validation of hand readings, and the closed forms of the checks that use them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from foldcell.robots.errors import FailureKind
from foldcell.robots.ports import GripperState, Side, TactileReading
from foldcell.skills.grasping.confirm import CONFIRM_READINGS, Held, LayerCount, LiftCheck, check_lift
from foldcell.skills.grasping.hand_reading import HandReading, validate_reading
from foldcell.skills.grasping.release import ReleaseState, release, start_release
from foldcell.skills.grasping.stuck_on_finger import (
    DRIFT_RATIO,
    DRIFT_TIME,
    STUCK_READINGS,
    STUCK_SIGMAS,
    StuckCheck,
    check_stuck,
    residual_bound,
)
from foldcell.skills.grasping.tare import TactileBias
from foldcell.skills.vocabulary import Outcome
from tests.builders.shipped_settings import GRASP

S = GRASP
BIAS = TactileBias(0.0, np.zeros((2, 4, 3)), np.zeros(2), 0.01)


def reading(now: float = 10.0, pads: tuple[float, float] = (12.0, 12.0), opening: float = 0.0025) -> HandReading:
    cells = np.stack([np.full((4, 3), pad / 12.0) for pad in pads])
    return HandReading(
        now,
        TactileReading(now, Side.LEFT, cells, np.array([0.1, 0.2])),
        GripperState(now, Side.LEFT, opening, 12.0, False, True),
        0.05,
        np.ones(7),
    )


@pytest.mark.parametrize(
    ("part", "name", "limit"), [("tactile", "tactile cells", 0.10), ("gripper", "gripper", 0.50)]
)
def test_each_sensor_has_its_own_maximum_age(part: str, name: str, limit: float) -> None:
    for age, old in ((0.98 * limit, False), (1.02 * limit, True), (np.nan, True), (np.inf, True)):
        given = reading()
        stale = replace(given, **{part: replace(getattr(given, part), stamp=given.stamp - age)})
        found = validate_reading(stale)
        assert (found is not None) is old
        if found is not None:
            assert found.kind is FailureKind.STALE_STATE and name in found.what
            assert found.values["limit_s"] == limit
            assert found.values["age_s"] == pytest.approx(age, nan_ok=True)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("part", "kind"),
    [
        ("height", FailureKind.STALE_STATE),
        ("effort", FailureKind.STALE_STATE),
        ("opening", FailureKind.GRIPPER_FAULT),
        ("force", FailureKind.GRIPPER_FAULT),
        ("cells", FailureKind.TACTILE_FAULT),
        ("tip", FailureKind.TACTILE_FAULT),
    ],
)
def test_a_hand_reading_without_one_of_its_values_is_a_fault_of_its_sensor(
    part: str, kind: FailureKind, wrong: float
) -> None:
    given = reading()
    cells, effort = given.tactile.cells.copy(), given.effort.copy()
    cells[1, 2, 0] = effort[6] = wrong
    changes: dict[str, dict[str, Any]] = {
        "height": {"height": wrong},
        "opening": {"gripper": replace(given.gripper, opening=wrong)},
        "force": {"gripper": replace(given.gripper, force=wrong)},
        "cells": {"tactile": replace(given.tactile, cells=cells)},
        "tip": {"tactile": replace(given.tactile, tip=np.array([0.0, wrong]))},
        "effort": {"effort": effort},
    }
    found = validate_reading(replace(given, **changes[part]))
    assert found is not None and found.kind is kind and found.hint


def test_an_open_state_older_than_the_open_command_does_not_count() -> None:
    """A state from before the command does not show the result of the command."""
    before = reading(opening=0.030)
    state: ReleaseState | Outcome = start_release(0.030, before)
    for k in range(5):
        assert isinstance(state, ReleaseState)
        late = replace(reading(before.stamp + 0.01 * k), gripper=before.gripper)
        _, state = release(late, state)
    assert isinstance(state, ReleaseState)
    _, state = release(reading(before.stamp + 0.06, opening=0.030), state)
    assert isinstance(state, Outcome) and state.unwrap().seconds == pytest.approx(0.06)


@pytest.mark.parametrize(("short", "opened"), [(0.0019, True), (0.0021, False), (-0.005, True)])
def test_pads_are_open_within_2_mm_of_the_command(short: float, opened: bool) -> None:
    state = start_release(0.030, reading())
    _, after = release(reading(10.01, opening=0.030 - short), state)
    assert isinstance(after, Outcome) is opened


def lifted(force: float, opening: float, empty: float) -> Outcome[Held]:
    """The lift check of a grasp that was confirmed with 10 N and 4 mm of cloth. force, opening: shares that remain
    after the lift."""
    settings = replace(S, empty_opening=empty)
    held = Held(9.0, 10.0, empty + 0.004, LayerCount((0.0, 1.0), 1.0, 0.1))
    state = LiftCheck(settings, BIAS, held)
    for k in range(100):
        weak = 10.0 * force
        after = check_lift(reading(10.0 + 0.01 * k, (weak, 2.0 * weak), empty + 0.004 * opening), state)
        if isinstance(after, Outcome):
            assert k + 1 == CONFIRM_READINGS
            return after
        state = after
    raise AssertionError("it never ends")


@pytest.mark.parametrize("empty", [0.0, 0.003, -0.001])
def test_force_and_opening_must_both_be_kept_over_a_lift(empty: float) -> None:
    """At least 60 % of the weaker pad's force and 60 % of the cloth's thickness must remain."""
    for force, opening, kept in (
        (1.0, 1.0, True), (0.62, 0.62, True), (0.58, 1.0, False), (1.0, 0.58, False), (1.5, 0.0, False),
        (1.4, 1.4, True),
    ):  # fmt: skip
        after = lifted(force, opening, empty)
        assert after.ok is kept
        if after.failure is not None:
            assert after.failure.kind is FailureKind.MISSED_GRASP
            assert after.failure.values["kept_force"] == pytest.approx(force)
            assert after.failure.values["kept_opening"] == pytest.approx(opening)
        else:
            assert after.unwrap().grip == pytest.approx(10.0 * force)


@pytest.mark.parametrize(("swing", "mean", "kept"), [(0.3, 0.65, True), (0.3, 0.55, False)])
@pytest.mark.parametrize("of", ["force", "opening"])
def test_a_grip_that_swings_after_the_lift_is_judged_by_its_mean(
    of: str, swing: float, mean: float, kept: bool
) -> None:
    held = Held(9.0, 10.0, 0.004, LayerCount((0.0, 1.0), 1.0, 0.1))
    state: Any = LiftCheck(S, BIAS, held)
    for k in range(CONFIRM_READINGS):
        share = mean + swing * (k % 3 - 1)
        force, opening = (share, 1.0) if of == "force" else (1.0, share)
        state = check_lift(reading(10.0 + 0.01 * k, (10.0 * force, 20.0), 0.004 * opening), state)
    assert isinstance(state, Outcome) and state.ok is kept


def test_a_repeated_reading_does_not_count_towards_the_stuck_check() -> None:
    state = check_stuck(reading(), StuckCheck(S, BIAS))
    for k in range(2 * STUCK_READINGS):
        state = check_stuck(replace(reading(), stamp=10.0 + 0.001 * k), state)
        assert not isinstance(state, Outcome)


def test_the_drift_allowance_grows_until_half_a_period() -> None:
    """The allowance covers white noise of means over 20 and 12 readings, and a sinusoidal drift 2 sigma sin(pi t /
    T), over 12 cells."""
    settings = replace(S, stuck_force=0.0)
    white = np.sqrt(1.0 / 20 + 1.0 / 12)
    for t in (0.0, 10.0, 30.0, 60.0, 90.0, 1e4):
        wander = 2.0 * DRIFT_RATIO * np.sin(np.pi * min(t / DRIFT_TIME, 0.5))
        bound = STUCK_SIGMAS * 0.01 * np.sqrt(12.0) * np.hypot(white, wander)
        assert residual_bound(BIAS, t, settings, 20) == pytest.approx(bound)
    assert residual_bound(replace(BIAS, cell_noise=0.0), 60.0, S, 20) == S.stuck_force


@pytest.mark.parametrize("pad", [0, 1])
@pytest.mark.parametrize(("share", "stuck"), [(0.98, False), (1.02, True)])
def test_cloth_on_either_pad_is_reported_above_the_threshold(pad: int, share: float, stuck: bool) -> None:
    state = StuckCheck(S, BIAS)
    weight = share * residual_bound(BIAS, 10.0 + 0.01 * (STUCK_READINGS - 1), S, STUCK_READINGS)
    for k in range(STUCK_READINGS):
        pads = (weight, -1.0) if pad == 0 else (-1.0, weight)
        after = check_stuck(reading(10.0 + 0.01 * k, pads), state)
        assert isinstance(after, Outcome) is (k == STUCK_READINGS - 1)
        if not isinstance(after, Outcome):
            state = after
    assert isinstance(after, Outcome) and after.ok is not stuck
    if after.failure is not None:
        assert after.failure.kind is FailureKind.STUCK_ON_FINGER and after.failure.values["pad"] == pad
