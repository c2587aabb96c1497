"""Streaming: the arms get what was planned, and every way of going wrong ends in a typed failure."""

from __future__ import annotations

import numpy as np
import pytest

from cell.execution import TICK_S, ExecutionLimits, stream, wait
from robots.errors import Failure, FailureKind
from robots.ports import ArmTrajectory
from tests.fakes import FakeCell

LIMITS = ExecutionLimits()


def ramp(distance: float = 0.5, duration: float = 1.0) -> ArmTrajectory:
    """A minimum-jerk motion of every joint."""
    t = np.linspace(0.0, duration, 101)
    s = t / duration
    shape = s**3 * (10 - 15 * s + 6 * s**2)
    speed = 30 * s**2 * (1 - s) ** 2 / duration
    one = np.ones(14) * distance
    return ArmTrajectory(t, np.outer(shape, one), np.outer(speed, one), np.zeros((101, 14)))


def test_the_arms_arrive_and_got_every_set_point() -> None:
    cell = FakeCell()
    outcome = stream(cell.ports(), ramp(), LIMITS)
    assert outcome.ok
    np.testing.assert_allclose(cell.q, 0.5)
    times = np.diff([t for t, _ in cell.commands])
    np.testing.assert_allclose(times, TICK_S, atol=1e-9)
    sent = np.array([q[0] for _, q in cell.commands])
    np.testing.assert_allclose(sent, [ramp().at(t)[0][0] for t, _ in cell.commands], atol=1e-12)


def test_the_interpolant_is_the_closed_form() -> None:
    """Between samples the table must give the minimum-jerk polynomial that it was made from."""
    for t in np.linspace(0.0, 1.0, 333):
        q, qd = ramp().at(float(t))
        assert q[0] == pytest.approx(0.5 * t**3 * (10 - 15 * t + 6 * t**2), abs=1e-6)
        assert qd[0] == pytest.approx(0.5 * 30 * t**2 * (1 - t) ** 2, abs=1e-3)


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda c: setattr(c, "stop_reason", "button"), FailureKind.STOPPED),
        (lambda c: setattr(c, "frozen_since", c.now), FailureKind.STALE_STATE),
        (lambda c: setattr(c, "follows", False), FailureKind.TRACKING_ERROR),
    ],
)
def test_what_goes_wrong_on_the_way_is_named(spoil, kind) -> None:
    cell = FakeCell()
    cell.at(0.3, lambda: spoil(cell))
    outcome = stream(cell.ports(), ramp(), LIMITS)
    assert outcome.failure is not None
    assert outcome.failure.kind is kind
    assert cell.now < 1.0, "it went on to the end of the motion"


def test_nothing_is_sent_after_a_stop() -> None:
    """The fake raises on a set-point to a stopped robot: the stream must see the stop within a tick."""
    cell = FakeCell()
    cell.at(0.5, lambda: setattr(cell, "stop_reason", "button"))
    assert stream(cell.ports(), ramp(), LIMITS).failure is not None
    assert max(t for t, _ in cell.commands) < 0.5 + 1e-9


def test_a_start_two_degrees_off_is_refused_before_anything_is_sent() -> None:
    q = np.zeros(14)
    q[3] = np.deg2rad(2.0)
    cell = FakeCell(q)
    failure = stream(cell.ports(), ramp(), LIMITS).failure
    assert failure is not None
    assert failure.kind is FailureKind.START_MISMATCH
    assert failure.values["joint"] == 3
    assert not cell.commands


def test_a_watcher_ends_the_motion_and_the_arms_hold() -> None:
    cell = FakeCell()
    slipped = Failure(FailureKind.SLIPPED, "gone")
    outcome = stream(cell.ports(), ramp(), LIMITS, lambda tick: slipped if tick.t >= 0.4 else None)
    assert outcome.failure is slipped
    np.testing.assert_allclose(cell.commands[-1][1], cell.q)
    assert cell.now == pytest.approx(0.4)


def test_waiting_keeps_the_arms_commanded() -> None:
    """The driver holds after 0.2 s without a command; a wait must not rely on that."""
    cell = FakeCell()
    assert wait(cell.ports(), 0.5) is None
    assert np.diff([t for t, _ in cell.commands]).max() < 0.2
