"""The table's height from presses: a spring on a hard stop, a plane, and contacts that are refused."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.calibration.effects import Bring, Reach, Touch, TouchReadings
from foldcell.calibration.table import MOST_POINTS, calibrate_table, check_points, contact_height, fit_plane
from foldcell.robots.errors import ConfigurationError, Failure, FailureKind
from foldcell.robots.ports import Side
from foldcell.skills.vocabulary import Outcome, Table
from tests.unit.calibration.conftest import run

TABLE = Table(-0.10, (0.20, 1.10), (-0.75, 0.75))
STIFFNESS = 1150.0


def press(z0: float, noise: float = 0.0, seed: int = 0, side: Side = Side.LEFT, at=(0.5, 0.2)) -> TouchReadings:
    """A slow press, 3 mm/s at 100 Hz, from 3 mm above z0 until 3 N."""
    height = z0 + 0.003 - 3e-5 * np.arange(int((0.003 + 3.0 / STIFFNESS) / 3e-5))
    force = STIFFNESS * np.maximum(0.0, z0 - height)
    rng = np.random.default_rng(seed)
    return TouchReadings(side, *at, height, force + noise * rng.standard_normal(len(height)))


def test_a_spring_on_a_hard_stop_gives_its_height_and_stiffness() -> None:
    z, k = contact_height(press(-0.1037)).unwrap()
    assert z == pytest.approx(-0.1037, abs=1e-9) and k == pytest.approx(STIFFNESS, rel=1e-6)


def test_noise_of_the_tips_costs_less_than_a_tenth_of_a_millimetre() -> None:
    off = [contact_height(press(-0.1, 0.042, seed)).unwrap()[0] + 0.1 for seed in range(200)]
    assert np.abs(off).max() < 1e-4 and abs(np.mean(off)) < 2e-5


def test_a_force_peak_before_the_contact_is_ignored() -> None:
    felt = press(-0.1)
    felt.force[20] = 0.9
    assert contact_height(felt).unwrap()[0] == pytest.approx(-0.1, abs=1e-9)


def felt_as(felt: TouchReadings, force: np.ndarray) -> TouchReadings:
    return TouchReadings(felt.side, felt.x, felt.y, felt.height, force)


@pytest.mark.parametrize("offset", [-0.5, 0.2, 0.3, 0.5])
def test_a_constant_tactile_offset_in_the_air_does_not_move_the_contact(offset: float) -> None:
    """A rubber tip that was pressed once keeps an offset when it is free again."""
    felt = press(-0.1, 0.03)
    z, k = contact_height(felt_as(felt, felt.force + offset)).unwrap()
    assert z == pytest.approx(-0.1, abs=5e-5) and k == pytest.approx(STIFFNESS, rel=0.02)


def test_a_press_that_begins_in_contact_is_fitted() -> None:
    felt = press(-0.1)
    on = felt.height < -0.1003
    begun = TouchReadings(felt.side, felt.x, felt.y, felt.height[on], felt.force[on])
    assert contact_height(begun).unwrap() == pytest.approx((-0.1, STIFFNESS), rel=1e-6)


@pytest.mark.parametrize("softness", [300.0, 500.0, 700.0])
def test_a_soft_contact_is_not_taken_for_the_table(softness: float) -> None:
    """A layer of 2 mm yields under the tips, above the table."""
    felt = press(-0.1, 0.03)
    soft = softness * np.clip(-0.098 - felt.height, 0.0, 0.002)
    refused = contact_height(felt_as(felt, felt.force + soft)).failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and "spring" in refused.what and refused.hint


@pytest.mark.parametrize("at", [20, 40, 60])
def test_a_jump_of_the_tactile_zero_gives_no_contact(at: int) -> None:
    felt = press(-0.1, 0.03)
    jumped = felt.force + np.where(np.arange(len(felt.force)) >= at, 0.5, 0.0)
    refused = contact_height(felt_as(felt, jumped)).failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE


def test_stiffening_tips_shift_the_contact_by_less_than_a_third_of_a_millimetre() -> None:
    felt = press(-0.1, 0.03)
    depth = np.maximum(0.0, -0.1 - felt.height)
    stiffening = STIFFNESS * depth * (1.0 + depth / depth.max()) / 2.0
    assert contact_height(felt_as(felt, stiffening)).unwrap()[0] == pytest.approx(-0.1, abs=3.5e-4)


@pytest.mark.parametrize("force", [0.0, 0.1])
def test_a_press_without_a_load_is_refused(force: float) -> None:
    felt = press(-0.1)
    nothing = TouchReadings(felt.side, felt.x, felt.y, felt.height, np.full(len(felt.height), force))
    refused = contact_height(nothing).failure
    assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and refused.hint


def plane(points: int, height: float = -0.104, a: float = 0.004, b: float = -0.003) -> np.ndarray:
    """(points, 3) points of a plane that span it."""
    places = [
        (0.45, 0.4),
        (0.45, -0.4),
        (0.72, 0.15),
        (0.72, -0.15),
        (0.6, 0),
        (0.68, 0.4),
        (0.5, -0.2),
        (0.6, 0.3),
    ]
    xy = np.array(places[:points])
    off = xy - xy.mean(axis=0)
    return np.column_stack((xy, height + a * off[:, 0] + b * off[:, 1]))


def fitted(points: np.ndarray) -> Outcome:
    sides = (Side.LEFT, Side.RIGHT) * len(points)
    return fit_plane(points, sides[: len(points)], np.full(len(points), STIFFNESS))


def test_an_exact_plane_is_recovered() -> None:
    c = fitted(plane(7)).unwrap()
    assert (c.height, c.tilt_x, c.tilt_y) == pytest.approx((-0.104, 0.004, -0.003), abs=1e-12)
    assert c.residual_rms == pytest.approx(0.0, abs=1e-12)


def test_the_residual_is_an_unbiased_estimate_of_the_noise() -> None:
    rng = np.random.default_rng(5)
    variances = []
    for _ in range(400):
        points = plane(6)
        points[:, 2] += 5e-4 * rng.standard_normal(6)
        c = fitted(points).unwrap()
        variances.append(c.residual_rms**2)
    assert np.sqrt(np.mean(variances)) == pytest.approx(5e-4, rel=0.06)


def test_three_points_leave_no_residual() -> None:
    assert fitted(plane(3)).unwrap().residual_rms is None


def test_collinear_points_outliers_and_tilted_tables_are_refused() -> None:
    line = plane(5)
    line[:, 1] = 0.5 * line[:, 0]
    thing = plane(8)
    thing[4, 2] += 0.012
    for points, word in ((line, "one line"), (thing, "off the plane"), (plane(6, a=0.03), "leans")):
        refused = fitted(points).failure
        assert refused and refused.kind is FailureKind.LOW_CONFIDENCE and word in refused.what and refused.hint


def flat(effect: Touch) -> Outcome:
    lift = 2e-4 if effect.side is Side.LEFT else -2e-4  # the two arms disagree
    return Outcome(press(-0.1042 + lift, side=effect.side, at=(effect.x, effect.y)))


def test_the_procedure_touches_with_both_arms_and_reports_their_difference() -> None:
    outcome, asked = run(calibrate_table(TABLE), {Touch: flat})
    c = outcome.unwrap()
    assert c.height == pytest.approx(-0.1042, abs=5e-5) and c.arms_differ == pytest.approx(4e-4, abs=1e-6)
    touches = [e for e in asked if isinstance(e, Touch)]
    assert len(touches) == 8 and {e.side for e in touches} == set(Side)
    assert not any(isinstance(e, Reach | Bring) for e in asked)


def test_a_point_out_of_reach_is_replaced_by_another() -> None:
    far = Outcome(failure=Failure(FailureKind.UNREACHABLE, "too far"))
    outcome, asked = run(calibrate_table(TABLE), {Touch: lambda e: far if e.x > 0.71 else flat(e)})
    assert len(outcome.unwrap().points) == 8
    assert sum(isinstance(e, Touch) for e in asked) == MOST_POINTS


def test_no_hand_descends_beside_a_narrow_table() -> None:
    narrow = Table(-0.10, (0.20, 1.10), (-0.35, 0.35))
    outcome, asked = run(calibrate_table(narrow), {Touch: flat})
    refused = outcome.failure
    assert refused and refused.kind is FailureKind.UNREACHABLE and not asked, "nothing moves"
    assert "6 of 8" in refused.what and "not on the table" in refused.what and "--points" in refused.hint
    outcome, asked = run(calibrate_table(narrow, 6), {Touch: flat})
    assert len(outcome.unwrap().points) == 6
    assert all(abs(e.y) <= 0.30 for e in asked if isinstance(e, Touch))
    short = Table(-0.10, (0.20, 0.75), (-0.75, 0.75))
    outcome, asked = run(calibrate_table(short), {Touch: flat})
    assert len(outcome.unwrap().points) == 8 and all(e.x <= 0.70 for e in asked if isinstance(e, Touch))


def test_the_procedure_ends_without_contact_or_with_too_few_points() -> None:
    air = Outcome(failure=Failure(FailureKind.NO_CONTACT, "nothing there"))
    outcome, asked = run(calibrate_table(TABLE), {Touch: lambda e: air})
    assert outcome.failure and outcome.failure.kind is FailureKind.NO_CONTACT and len(asked) == 1
    far = Outcome(failure=Failure(FailureKind.IN_COLLISION, "in the way"))
    outcome, _ = run(calibrate_table(TABLE), {Touch: lambda e: far if e.side is Side.LEFT else flat(e)})
    assert outcome.failure and outcome.failure.kind is FailureKind.UNREACHABLE and "5 of 8" in outcome.failure.what


@pytest.mark.parametrize("points", [0, 2, MOST_POINTS + 1])
def test_too_few_points_for_a_plane_are_refused(points: int) -> None:
    with pytest.raises(ConfigurationError, match="3 to"):
        check_points(points)
