"""Joint commands of an emulated arm: joint order, timeout, velocity and ignored commands."""

from __future__ import annotations

import math

import numpy as np
import pytest

from foldcell.robots.baxter.emulator.initial_state import InitialState
from foldcell.robots.baxter.emulator.limbs import TICK, Limb
from foldcell.robots.baxter.names import ARM_JOINTS, FULL_SPEED
from foldcell.robots.ports import Array, Side

NAMES = [f"left_{joint}" for joint in ARM_JOINTS]
Q = np.linspace(-0.3, 0.3, 7)
ELSEWHERE = np.full(7, 0.5)


def hear(limb: Limb, q: Array, at: float, mode: int = 4, now: float | None = None) -> str | None:
    return limb.hear(mode, NAMES, list(q), at, at if now is None else now)


def follow(limb: Limb, now: float) -> tuple[Array, Array]:
    return limb.set_point(now, ELSEWHERE)


@pytest.mark.parametrize("mode", [1, 4])
def test_a_command_is_read_by_joint_names_in_any_order(mode: int) -> None:
    limb, order = Limb(Side.LEFT), [3, 0, 6, 2, 5, 1, 4]
    assert limb.hear(mode, [NAMES[k] for k in order], [Q[k] for k in order], 1.0, 1.0) is None
    q, qd = limb.set_point(1.0, Q + 1e-3)
    np.testing.assert_array_equal(q, Q)
    np.testing.assert_array_equal(qd, np.zeros(7))  # a single set-point has no velocity


@pytest.mark.parametrize(
    ("names", "values"),
    [
        (NAMES, Q[:6]),
        (NAMES[:6], Q),
        (NAMES, [*Q, 0.0]),
        ([*NAMES, "left_w3"], [*Q, 0.0]),
        ([*NAMES[:6], NAMES[0]], Q),
        ([name.replace("left", "right") for name in NAMES], Q),
        ([], []),
        (NAMES, [*Q[:6], math.nan]),
        (NAMES, [*Q[:6], math.inf]),
    ],
)
@pytest.mark.parametrize("mode", [1, 2])
def test_a_malformed_command_changes_nothing(names: list[str], values: Array, mode: int) -> None:
    limb = Limb(Side.LEFT)
    assert limb.hear(mode, names, list(values), 1.0, 1.0) is not None
    assert not limb.fresh(1.0)
    hear(limb, Q, 1.0)
    assert limb.hear(mode, names, list(values), 1.1, 1.1) is not None
    assert not limb.fresh(1.25)  # a malformed command does not extend the earlier one
    np.testing.assert_array_equal(follow(limb, 1.1)[0], Q)


def test_joints_that_a_command_does_not_name_stay_where_they_are() -> None:
    """As when the SDK's example turns single joints by keys."""
    limb = Limb(Side.LEFT)
    assert limb.hear(4, [NAMES[5]], [0.7], 1.0, 1.0) is None
    assert limb.fresh(1.0)
    expected = np.where(np.arange(7) == 5, 0.7, ELSEWHERE)
    np.testing.assert_array_equal(follow(limb, 1.0)[0], expected)
    assert limb.hear(4, [NAMES[2], NAMES[0]], [0.1, 0.2], 1.01, 1.01) is None
    expected[[2, 0]] = 0.1, 0.2
    q, qd = follow(limb, 1.01)
    np.testing.assert_array_equal(q, expected)
    assert np.isfinite(qd).all() and not qd[[1, 3, 4, 5, 6]].any()


def test_a_command_is_fresh_until_the_timeout_and_the_limb_stays_there() -> None:
    limb = Limb(Side.LEFT)
    assert not limb.fresh(0.0)
    hear(limb, Q, 1.0)
    assert limb.fresh(1.2) and not limb.fresh(1.21)
    np.testing.assert_array_equal(follow(limb, 5.0)[0], Q)


def test_the_command_timeout_can_be_set() -> None:
    limb = Limb(Side.LEFT)
    assert limb.hear_timeout(0.5) is None
    hear(limb, Q, 1.0)
    assert limb.fresh(1.5) and not limb.fresh(1.51)
    for senseless in (0.0, -1.0, math.nan, math.inf):
        assert limb.hear_timeout(senseless) is not None
    assert limb.fresh(1.5) and not limb.fresh(1.51)


def test_the_velocity_is_that_between_the_last_two_set_points() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.0)
    hear(limb, Q + 0.004, 1.02)
    q, qd = follow(limb, 1.03)
    np.testing.assert_allclose(q, Q + 0.004)
    np.testing.assert_allclose(qd, np.full(7, 0.2))
    hear(limb, Q + 0.008, 1.02)  # a set-point of the same time replaces the previous one
    np.testing.assert_allclose(follow(limb, 1.03)[1], np.full(7, 0.4))


def test_the_velocity_is_limited_to_the_joints_maximum() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.0)
    hear(limb, Q - 1.0, 1.01)
    np.testing.assert_array_equal(follow(limb, 1.02)[1], -FULL_SPEED)


def test_commands_that_a_network_delivers_together_give_no_higher_velocity() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.0)
    hear(limb, Q + 0.002, 1.001)
    np.testing.assert_allclose(follow(limb, 1.01)[1], np.full(7, 0.2))


def test_set_points_far_apart_in_time_have_no_velocity() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.0)
    hear(limb, Q + 0.01, 1.06)
    np.testing.assert_array_equal(follow(limb, 1.07)[1], np.zeros(7))


def test_a_late_command_is_extrapolated_for_two_ticks_and_then_held() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.00)
    hear(limb, Q + 0.002, 1.01)
    due = 1.01 + TICK
    for late in (0.0, TICK, 2 * TICK):
        q, qd = follow(limb, due + late)
        np.testing.assert_allclose(q, Q + 0.002 + 0.2 * late)
        np.testing.assert_allclose(qd, np.full(7, 0.2))
    q, qd = follow(limb, due + 3 * TICK)
    np.testing.assert_array_equal(q, Q + 0.002)
    np.testing.assert_array_equal(qd, np.zeros(7))


def test_a_limb_without_a_command_holds_its_first_reported_position() -> None:
    limb = Limb(Side.LEFT)
    np.testing.assert_array_equal(limb.set_point(1.0, Q)[0], Q)
    # with each new reading a sagging limb would creep away
    np.testing.assert_array_equal(limb.set_point(1.01, Q - 0.01)[0], Q)


@pytest.mark.parametrize("mode", [2, 3, 0, 7])
def test_an_unsupported_control_mode_holds_the_limb(mode: int) -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.00)
    hear(limb, Q + 0.002, 1.01)
    assert "mode" in (hear(limb, ELSEWHERE, 1.02, mode) or "")
    assert limb.fresh(1.22) and not limb.fresh(1.23)
    q, qd = follow(limb, 1.03)
    np.testing.assert_array_equal(q, Q + 0.002)
    np.testing.assert_array_equal(qd, np.zeros(7))


def test_a_command_that_expired_before_it_was_read_is_ignored() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.0)
    hear(limb, ELSEWHERE, 1.1, now=4.0)
    assert not limb.fresh(4.0)
    np.testing.assert_array_equal(follow(limb, 4.0)[0], Q)


def test_a_limb_can_discard_its_command() -> None:
    limb = Limb(Side.LEFT)
    hear(limb, Q, 1.0)
    limb.forget()
    assert not limb.fresh(1.0)
    np.testing.assert_array_equal(follow(limb, 1.0)[0], ELSEWHERE)


def drive(limb: Limb, goal: Array, seconds: float, mode: int, begin: float = 1.0) -> Array:
    """Set-points (ticks, 7) while the goal is commanded on every tick."""
    path = []
    for k in range(round(seconds / TICK)):
        hear(limb, goal, begin + k * TICK, mode)
        path.append(limb.set_point(begin + k * TICK, ELSEWHERE)[0])
    return np.array(path)


@pytest.mark.parametrize("ratio", [0.1, 0.3, 1.0])
def test_position_mode_keeps_the_commanded_speed_ratio(ratio: float) -> None:
    limb = Limb(Side.LEFT)
    assert limb.hear_speed_ratio(ratio) is None
    fastest = ratio * FULL_SPEED
    path = np.vstack((ELSEWHERE, drive(limb, Q, 0.8 / fastest.min() + 0.1, mode=1)))
    assert np.all(np.abs(np.diff(path, axis=0)) <= fastest * TICK + 1e-9)
    np.testing.assert_allclose(path[1], np.maximum(ELSEWHERE - fastest * TICK, Q))
    np.testing.assert_array_equal(path[-1], Q)
    np.testing.assert_array_equal(drive(Limb(Side.LEFT), Q, 0.02, mode=4)[0], Q)


def test_position_mode_stops_when_the_command_expires() -> None:
    limb = Limb(Side.LEFT)
    way = drive(limb, Q, 0.05, mode=1)[-1]
    for k in range(60):
        last, qd = follow(limb, 1.04 + k * TICK)
    assert np.all(np.abs(last - way) <= 0.3 * FULL_SPEED * 0.21) and not np.allclose(last, Q, atol=0.1)
    np.testing.assert_array_equal(qd, np.zeros(7))
    np.testing.assert_array_equal(follow(limb, 3.0)[0], last)


def test_position_mode_stops_on_a_command_in_another_mode() -> None:
    limb = Limb(Side.LEFT)
    way = drive(limb, Q, 0.05, mode=1)[-1]
    assert hear(limb, Q, 1.05, mode=2) is not None
    np.testing.assert_array_equal(follow(limb, 1.05)[0], way)


def test_the_default_speed_ratio_is_0_3() -> None:
    assert Limb(Side.LEFT).speed_ratio == pytest.approx(0.3)
    limb = Limb(Side.LEFT, InitialState(speed_ratio=0.1, timeout=1.0))
    assert (limb.speed_ratio, limb.timeout) == (0.1, 1.0)
    assert limb.hear_speed_ratio(math.nan) is not None
    assert limb.speed_ratio == 0.1
    for asked, kept in ((-0.5, 0.0), (0.0, 0.0), (1.5, 1.0), (math.inf, 1.0)):
        assert limb.hear_speed_ratio(asked) is None
        assert limb.speed_ratio == kept, "it is clipped, as the SDK states"
