"""Waiting for the arms to come to rest, and the record of the path that they came."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.cell.control.loop import ControlLoop
from foldcell.cell.control.motions.trajectory import stream
from foldcell.cell.control.path_clock import PathControl
from foldcell.cell.control.rest import REST_S, STILL_S, await_rest, stand_by
from foldcell.cell.control.set_points import SPACING, LastCommand, PathRecord
from foldcell.cell.control.ticks import TICK_S
from foldcell.robots.errors import FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import ArmTrajectory
from tests.builders.shipped_settings import LIMITS
from tests.fakes import FakeCell

ONE = np.ones(14)
JOINTS = JointLimits(-3.0 * ONE, 3.0 * ONE, 1.5 * ONE, 6.0 * ONE, 120.0 * ONE)


def drift(cell: FakeCell, speed: float, until: float) -> None:
    """The arms move by themselves until a moment of cell time."""
    for k in range(round(until / TICK_S)):
        cell.at(k * TICK_S, lambda: cell.q.__iadd__(speed * TICK_S))


def test_resting_arms_are_awaited_for_the_shortest_time() -> None:
    cell = FakeCell()
    assert await_rest(cell.ports(), LIMITS) is None
    assert cell.now == pytest.approx(STILL_S, abs=2 * TICK_S) and cell.commands == []


@pytest.mark.parametrize("moves_s", [0.3, 1.0, 2.0])
def test_moving_arms_are_awaited_without_a_set_point(moves_s: float) -> None:
    cell = FakeCell()
    drift(cell, 0.3, moves_s)
    assert await_rest(cell.ports(), LIMITS) is None
    assert moves_s < cell.now < moves_s + STILL_S + 0.05 and cell.commands == []


def test_a_slow_drift_is_not_rest() -> None:
    """0.05 rad/s is half a centimetre at the hand every tenth of a second."""
    cell = FakeCell()
    drift(cell, 0.05, 9.0)
    failure = await_rest(cell.ports(), LIMITS)
    assert failure is not None and failure.kind is FailureKind.TRACKING_ERROR
    assert cell.now == pytest.approx(REST_S, abs=2 * TICK_S)


@pytest.mark.parametrize("back_s", [1.0, None])
def test_an_unknown_state_is_not_rest(back_s: float | None) -> None:
    cell = FakeCell()
    cell.now, cell.frozen_since = 5.0, 4.0
    if back_s is not None:
        cell.at(5.0 + back_s, lambda: setattr(cell, "frozen_since", None))
    failure = await_rest(cell.ports(), LIMITS)
    if back_s is None:
        assert failure is not None and failure.kind is FailureKind.STALE_STATE
        assert cell.now == pytest.approx(5.0 + REST_S, abs=2 * TICK_S)
    else:
        assert failure is None and cell.now == pytest.approx(5.0 + back_s + STILL_S, abs=3 * TICK_S)


def test_arms_whose_state_was_unknown_are_watched_anew() -> None:
    """They may have moved meanwhile, and come back."""
    cell = FakeCell()
    cell.at(0.1, lambda: setattr(cell, "frozen_since", 0.1))
    cell.at(1.0, lambda: setattr(cell, "frozen_since", None))
    assert await_rest(cell.ports(), LIMITS) is None
    assert cell.now == pytest.approx(1.0 + STILL_S, abs=3 * TICK_S)


def test_stopped_arms_are_awaited_until_they_rest_and_the_stop_is_reported() -> None:
    cell = FakeCell()
    drift(cell, 0.3, 0.4)
    cell.ports().stop.trigger("button")
    failure = await_rest(cell.ports(), LIMITS)
    assert failure is not None and failure.kind is FailureKind.STOPPED and 0.4 < cell.now < 0.8


@pytest.mark.parametrize("stopped", [False, True])
def test_standing_by_sends_nothing_and_ends_with_a_stop(stopped: bool) -> None:
    cell = FakeCell()
    if stopped:
        cell.at(0.5, lambda: cell.ports().stop.trigger("button"))
    stand_by(cell.ports(), 2.0)
    assert cell.now == pytest.approx(0.5 if stopped else 2.0, abs=TICK_S) and cell.commands == []


def sweep(q0: float, q1: float) -> ArmTrajectory:
    """All joints move between two positions in one second, with minimum jerk."""
    t = np.linspace(0.0, 1.0, 101)
    u, d = t[:, None], q1 - q0
    q = q0 + d * u**3 * (10 - 15 * u + 6 * u**2) * ONE
    return ArmTrajectory(t, q, d * 30 * u**2 * (1 - u) ** 2 * ONE, np.zeros_like(q))


def test_the_loop_records_the_set_points_of_all_motions_for_the_way_back() -> None:
    cell = FakeCell()
    loop = ControlLoop(cell.ports(), LIMITS, LastCommand())
    for q0, q1 in ((0.0, 0.4), (0.4, 0.1)):
        assert stream(loop, sweep(q0, q1), None, PathControl(None, JOINTS, JOINTS)).ok
    back = loop.path.back()
    assert np.abs(back[0] - 0.1).max() < SPACING and np.abs(back[-1]).max() < SPACING
    assert back.max() == pytest.approx(0.4, abs=SPACING)
    gaps = np.abs(np.diff(back, axis=0)).max(axis=1)
    assert gaps.min() >= SPACING and gaps.max() < 3 * SPACING
    loop.path.forget()
    assert len(loop.path.back()) == 0


def test_the_record_is_bounded() -> None:
    record = PathRecord()
    for k in range(10_000):
        record.add(0.02 * k * ONE)
    assert 1000 < len(record.back()) < 10_000 and record.back()[0] == pytest.approx(0.02 * 9999)
