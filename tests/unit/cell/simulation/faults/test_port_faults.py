"""Faults at the ports alter the answers as stated, and no longer than stated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TypeVar

import numpy as np
import pytest

from foldcell.cell.simulation.faults import Fault, FaultBoard, FaultKind
from foldcell.cell.simulation.faults.port_faults import PortFaults
from foldcell.robots.ports import GripperState, JointState, Side, TactileReading

K = FaultKind
T = TypeVar("T")
DT = 0.01


class Cell:
    """Sound readings of a cell whose joints move at 1 rad/s, and faults at its ports. A fault starts at 1 s and
    ends at 2 s."""

    def __init__(self, kind: FaultKind, side: Side | None = None, size: float | None = None) -> None:
        self.board = FaultBoard()
        self.board.add(Fault(kind, side=side, at=1.0, size=size, duration=1.0))
        self.faults = PortFaults(self.board)

    @property
    def t(self) -> float:
        return self.board.now

    def joints(self) -> JointState:
        values = np.full(14, self.t)
        return self.faults.joint_state(JointState(self.t, values, values, values, 0.0))

    def sound(self, side: Side) -> TactileReading:
        force = 1.0 + self.t + (10.0 if side is Side.RIGHT else 0.0)
        return TactileReading(self.t, side, np.full((2, 3, 4), force), np.full(2, force))

    def pads(self, side: Side = Side.LEFT) -> TactileReading:
        return self.faults.tactile(side, self.sound)

    def gripper(self, side: Side = Side.LEFT) -> GripperState:
        return self.faults.gripper(GripperState(self.t, side, 0.02, 5.0, False, True))

    def over(self, read: Callable[[], T]) -> Iterator[tuple[float, T]]:
        """(time, reading) at 100 Hz, from 0 to 3 s."""
        for k in range(300):
            self.board.now = round(k * DT, 9)
            yield self.t, read()


def test_without_faults_every_answer_is_the_sound_reading_itself() -> None:
    board = FaultBoard()
    board.now, faults = 1.0, PortFaults(board)
    state = JointState(1.0, np.zeros(14), np.zeros(14), np.zeros(14), 0.0)
    gripper = GripperState(1.0, Side.LEFT, 0.02, 5.0, False, True)
    reading = TactileReading(1.0, Side.LEFT, np.zeros((2, 3, 4)), np.zeros(2))
    assert faults.joint_state(state) is state and faults.stamped(state) is state
    assert faults.gripper(gripper) is gripper
    assert faults.tactile(Side.LEFT, lambda side: reading) is reading
    assert faults.wake_at(7.25) == 7.25 and faults.cell_time() == 1.0 and faults.delivers()


@pytest.mark.parametrize(("kind", "fresh"), [(K.JOINT_STATE_STALE, False), (K.JOINT_STATE_FROZEN, True)])
def test_stale_and_frozen_joint_states_keep_their_values(kind: FaultKind, fresh: bool) -> None:
    cell = Cell(kind)
    for t, state in cell.over(cell.joints):
        kept = 1.0 if 1.0 <= t < 2.0 else t
        assert state.q[0] == kept and state.stamp == (t if fresh else kept)


def test_duplicated_joint_states_are_repeated_for_the_stated_time() -> None:
    cell = Cell(K.JOINT_STATE_DUPLICATED, size=0.05)
    states = list(cell.over(cell.joints))
    during = [state.stamp for t, state in states if 1.0 <= t < 2.0]
    assert all(0.0 <= t - state.stamp < 0.05 for t, state in states)
    assert len(set(during)) == pytest.approx(len(during) * DT / 0.05, abs=1)
    assert all(state.stamp == t for t, state in states if not 1.0 <= t < 2.0)


def test_joint_states_out_of_order_alternate_with_old_ones() -> None:
    cell = Cell(K.JOINT_STATE_OUT_OF_ORDER, size=0.2)
    states = list(cell.over(cell.joints))
    assert all(state.stamp == state.q[0] for _, state in states), "an old state is a true one"
    late = [t - state.stamp for t, state in states if 1.3 <= t < 2.0]
    assert sum(age == 0.0 for age in late) == pytest.approx(len(late) / 2, abs=1)
    assert {round(age, 2) for age in late} == {0.0, 0.2}
    stamps = [state.stamp for t, state in states if 1.3 <= t < 2.0]
    assert any(b < a for a, b in pairwise(stamps))
    assert all(state.stamp == t for t, state in states if not 1.0 <= t < 2.0)


def test_joint_states_that_are_not_numbers() -> None:
    cell = Cell(K.JOINT_STATE_NAN)
    for t, state in cell.over(cell.joints):
        assert state.stamp == t
        assert np.isnan(state.q).all() == np.isnan(state.qd).all() == (1.0 <= t < 2.0)


def test_starved_set_points_do_not_reach_the_robot() -> None:
    cell = Cell(K.SETPOINTS_STARVED)
    assert [t for t, delivered in cell.over(cell.faults.delivers) if not delivered] == pytest.approx(
        [1.0 + k * DT for k in range(100)]
    )


@pytest.mark.parametrize(
    ("kind", "size", "value"),
    [(K.TACTILE_DEAD, None, 0.0), (K.TACTILE_SATURATED, 8.0, 8.0), (K.TACTILE_NAN, None, np.nan)],
)
def test_pads_that_read_one_value(kind: FaultKind, size: float | None, value: float) -> None:
    cell = Cell(kind, Side.LEFT, size)
    for t, reading in cell.over(cell.pads):
        expected = value if 1.0 <= t < 2.0 else 1.0 + t
        assert reading.stamp == t
        np.testing.assert_array_equal(reading.cells, expected)
        np.testing.assert_array_equal(reading.tip, expected)
        np.testing.assert_array_equal(cell.pads(Side.RIGHT).cells, 1.0 + t + 10.0)


def test_constant_pads_have_fresh_stamps_and_stale_ones_have_not() -> None:
    constant, stale = Cell(K.TACTILE_CONSTANT, Side.LEFT), Cell(K.TACTILE_STALE, Side.LEFT)
    for (t, fresh), (_, old) in zip(constant.over(constant.pads), stale.over(stale.pads), strict=True):
        since = 1.0 if 1.0 <= t < 2.0 else t
        assert fresh.cells[0, 0, 0] == old.cells[0, 0, 0] == 1.0 + since
        assert fresh.stamp == t and old.stamp == since


def test_swapped_pads_report_the_other_hands_forces() -> None:
    cell = Cell(K.TACTILE_SWAPPED)
    for t, reading in cell.over(cell.pads):
        right = cell.pads(Side.RIGHT)
        assert (reading.side, right.side) == (Side.LEFT, Side.RIGHT)
        swapped = 1.0 <= t < 2.0
        assert reading.tip[0] == 1.0 + t + (10.0 if swapped else 0.0)
        assert right.tip[0] == 1.0 + t + (0.0 if swapped else 10.0)


@pytest.mark.parametrize(
    ("kind", "size", "opening"), [(K.GRIPPER_OFFSET, 0.003, 0.023), (K.GRIPPER_SCALE, 1.25, 0.025)]
)
def test_a_gripper_reports_a_wrong_opening(kind: FaultKind, size: float, opening: float) -> None:
    cell = Cell(kind, Side.RIGHT, size)
    for t, state in cell.over(lambda: cell.gripper(Side.RIGHT)):
        assert state.opening == pytest.approx(opening if 1.0 <= t < 2.0 else 0.02)
        assert cell.gripper(Side.LEFT).opening == 0.02


@pytest.mark.parametrize("kind", [K.GRIPPER_OFFSET, K.GRIPPER_SCALE])
def test_a_calibration_of_that_gripper_ends_its_wrong_opening(kind: FaultKind) -> None:
    cell = Cell(kind, Side.RIGHT)
    cell.board.now = 1.5
    assert cell.gripper(Side.RIGHT).opening > 0.02
    cell.faults.calibrated(Side.LEFT)
    assert cell.gripper(Side.RIGHT).opening > 0.02
    cell.faults.calibrated(Side.RIGHT)
    assert cell.gripper(Side.RIGHT).opening == 0.02


def clocked(fault: Fault) -> Cell:
    cell = Cell(K.JOINT_STATE_NAN)
    cell.board = FaultBoard()
    cell.faults = PortFaults(cell.board)
    cell.board.add(fault)
    return cell


@pytest.mark.parametrize("step", [0.5, -0.5])
def test_a_stepped_clock_shows_in_every_later_time_and_stamp(step: float) -> None:
    cell = clocked(Fault(K.CLOCK_STEP, at=1.0, size=step))
    for t, shown in cell.over(cell.faults.cell_time):
        expected = t + (step if t >= 1.0 else 0.0)
        assert shown == pytest.approx(expected)
        assert cell.joints().stamp == cell.pads().stamp == cell.gripper().stamp == pytest.approx(expected)
    assert cell.faults.wake_at(7.0) == pytest.approx(7.0 - step), "a sleep ends when the stepped clock says so"


def test_a_stepped_clock_does_not_delay_the_next_fault() -> None:
    """A script gives the times of its faults by the cell's clock."""
    cell = clocked(Fault(K.CLOCK_STEP, at=1.0, size=5.0))
    cell.board.now = 1.0
    assert cell.faults.cell_time() == 6.0
    cell.board.add(Fault(K.TACTILE_DEAD, side=Side.LEFT, at=6.5, duration=1.0))
    dead = [t for t, reading in cell.over(cell.pads) if reading.tip[0] == 0.0]
    assert (min(dead), max(dead)) == pytest.approx((1.5, 2.49))


def test_a_stalled_program_oversleeps_once() -> None:
    cell = clocked(Fault(K.PROGRAM_STALLED, at=1.0, size=0.6))
    cell.board.now = 0.99
    assert cell.faults.wake_at(1.0) == 1.0
    cell.board.now = 1.0
    assert cell.faults.wake_at(1.01) == pytest.approx(1.61)
    assert cell.faults.wake_at(1.62) == 1.62
