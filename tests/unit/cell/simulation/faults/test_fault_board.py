"""Injected faults wait for their conditions, happen once and last for their duration."""

from __future__ import annotations

import pytest

from foldcell.cell.simulation.faults import Fault, FaultBoard, FaultKind
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Side


def test_a_fault_waits_for_side_grasp_and_time_and_happens_once() -> None:
    board = FaultBoard()
    fault = Fault(FaultKind.MISSED_GRASP, side=Side.LEFT, grasp=2, at=5.0)
    board.add(fault)

    def take(now: float, side: Side, grasp: int) -> Fault | None:
        board.now = now
        return board.take(FaultKind.MISSED_GRASP, side, grasp)

    assert take(9.0, Side.RIGHT, 2) is None
    assert take(9.0, Side.LEFT, 1) is None
    assert take(4.0, Side.LEFT, 2) is None
    assert take(5.0, Side.LEFT, 2) is fault
    assert take(6.0, Side.LEFT, 2) is None
    assert board.happened == [(5.0, fault)]


def test_a_fault_waits_for_its_fold() -> None:
    board = FaultBoard()
    board.add(Fault(FaultKind.SUDDEN_DROP, fold=1))
    assert board.take(FaultKind.SUDDEN_DROP, Side.LEFT) is None
    board.fold = 1
    drop = board.take(FaultKind.SUDDEN_DROP, Side.LEFT)
    assert drop is not None and drop.extent == pytest.approx(0.03) and drop.lasts == pytest.approx(0.4)


def test_a_corner_is_dropped_at_the_given_height() -> None:
    board = FaultBoard()
    board.add(Fault(FaultKind.DROPPED_CORNER, size=0.1))
    assert board.take(FaultKind.DROPPED_CORNER, Side.LEFT, 1, lifted=0.09) is None
    assert board.take(FaultKind.DROPPED_CORNER, Side.LEFT, 1, lifted=0.11) is not None


def test_a_fault_lasts_for_its_duration() -> None:
    board = FaultBoard()
    board.add(Fault(FaultKind.CAMERA_BLACK, at=2.0, duration=3.0))
    for board.now, lasts in ((1.0, False), (2.5, True), (5.0, True), (5.6, False)):
        assert (board.active(FaultKind.CAMERA_BLACK) is not None) is lasts


def test_a_fault_without_a_side_affects_only_the_first_matching_hand() -> None:
    board = FaultBoard()
    board.add(Fault(FaultKind.GRIPPER_STUCK, at=2.0, duration=3.0))
    for board.now, stuck in ((1.0, []), (2.5, [Side.LEFT]), (4.0, [Side.LEFT]), (6.0, [])):
        assert [side for side in Side if board.active(FaultKind.GRIPPER_STUCK, side) is not None] == stuck


@pytest.mark.parametrize(
    "arguments",
    [
        {"kind": FaultKind.CAMERA_BLACK, "side": Side.LEFT},
        {"kind": FaultKind.NO_GARMENT, "grasp": 1},
        {"kind": FaultKind.MISSED_GRASP, "grasp": 0},
        {"kind": FaultKind.SUDDEN_DROP, "at": -1.0},
        {"kind": FaultKind.GRIPPER_STUCK, "size": 0.03},
        {"kind": FaultKind.MISSED_GRASP, "duration": 2.0},
        {"kind": FaultKind.NO_GARMENT, "duration": 2.0},
    ],
)
def test_faults_with_unsupported_or_impossible_conditions_are_refused(arguments: dict) -> None:
    with pytest.raises(ConfigurationError):
        Fault(**arguments)
