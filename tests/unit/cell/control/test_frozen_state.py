"""Joint states that keep their positions under fresh stamps are found while the arms are moved."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.control.checks import FrozenStateWatch
from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motions.hold_position import wait
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.set_points import LastCommand
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import Failure, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import JointState
from foldcell.skills.motion.timing.timing import free_motion
from tests.builders.shipped_settings import LIMITS
from tests.fakes import FakeCell

ONE = np.ones(14)
JOINTS = JointLimits(-3.0 * ONE, 3.0 * ONE, 1.5 * ONE, 6.0 * ONE, 120.0 * ONE)


def found_at(speed: float, noise: float, lag: int, seconds: float = 1.0) -> tuple[int, Failure | None]:
    """Set-points at `speed` [rad/s]; the arms follow `lag` ticks later and stop for good after half the time.

    Returns the tick after that stop at which a failure is found, and the failure.
    """
    rng, watch, ticks = np.random.default_rng(3), FrozenStateWatch(), round(seconds / TICK_S)
    for k in range(ticks):
        setpoint = np.full(14, speed * TICK_S * k)
        where = speed * TICK_S * max(0, min(k - lag, ticks // 2))
        q = np.full(14, where) + noise * rng.standard_normal(14)
        failure = watch.check(JointState(TICK_S * k, q, np.zeros(14), np.zeros(14), 0.0), setpoint)
        if failure:
            return k - ticks // 2 - lag, failure
    return ticks, None


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("speed", [0.05, 0.2, 1.0])
def test_repeated_positions_are_found_within_a_tenth_of_a_second_of_motion(speed: float, lag: int) -> None:
    tick, failure = found_at(speed, 0.0, lag)
    assert failure is not None and failure.kind is FailureKind.STALE_STATE
    assert "exactly the same" in failure.what
    assert 0 < tick <= np.ceil(max(0.1, 0.005 / speed) / TICK_S) + 2


def test_arms_that_hang_are_not_taken_for_a_frozen_state() -> None:
    """Their encoders still have noise. The tracking error finds them."""
    assert found_at(0.5, 2e-4, 2)[1] is None


def test_arms_that_hold_may_repeat_their_positions() -> None:
    cell = FakeCell()
    loop = ControlLoop(cell.ports(), LIMITS, LastCommand())
    assert wait(loop, 1.0) is None


@pytest.mark.parametrize("left_rad", [0.02, 0.05, 0.1])
def test_a_state_that_freezes_near_the_end_of_a_motion_does_not_count_as_arrival(left_rad: float) -> None:
    """Less than the permitted tracking error is left, so only the repetition shows that nobody knows where the
    arms are. No set-point leads them back to the old position."""
    cell = FakeCell()

    trajectory = free_motion(np.zeros(14), np.full(14, 0.5), JOINTS)
    at = float(trajectory.t[np.searchsorted(trajectory.q[:, 0], 0.5 - left_rad)])
    seen = np.full(14, 0.5 - left_rad)

    def freeze() -> None:
        cell.follows = False
        cell.q = seen

    cell.at(at, freeze)
    loop = ControlLoop(cell.ports(), LIMITS, LastCommand())
    outcome = stream(loop, trajectory, None, PathControl(None, JOINTS, JOINTS))
    assert outcome.failure is not None and outcome.failure.kind is FailureKind.STALE_STATE
    sent = np.array([q[0] for _, q in cell.commands])
    assert np.diff(sent).min() > -1e-9, "no set-point leads back"
