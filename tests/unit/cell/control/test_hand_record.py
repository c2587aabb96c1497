"""The record of the hands keeps good readings since the cloth was lifted, and no others."""

import numpy as np

from foldcell.cell.control.hand_record import HandRecord
from foldcell.cell.control.motion import Tick
from foldcell.robots.ports import JointState, Side
from tests.fakes import FakeCell
from tests.workcells import fake_workcell

OPENINGS = {Side.LEFT: 0.002, Side.RIGHT: 0.003}


def state(stamp, q=0.0):
    return JointState(stamp, np.full(14, q), np.zeros(14), np.zeros(14), 0.0)


def test_only_newer_finite_readings_are_kept_and_only_after_the_lift():
    record = HandRecord()
    record.add(state(1.0), OPENINGS)
    assert len(record.readings()[0]) == 0
    record.begin()
    for stamp, q in ((2.0, 0.1), (2.0, 0.2), (1.5, 0.3), (2.1, np.nan), (2.2, 0.4)):
        record.add(state(stamp, q), OPENINGS)
    t, joints, openings = record.readings()
    np.testing.assert_array_equal(t, [2.0, 2.2])
    np.testing.assert_array_equal(joints[:, 0], [0.1, 0.4])
    np.testing.assert_array_equal(openings, [[0.002, 0.003]] * 2)


def test_a_new_lift_begins_a_new_record():
    record = HandRecord()
    record.begin()
    record.add(state(1.0), OPENINGS)
    record.begin()
    record.add(state(2.0), OPENINGS)
    assert record.readings()[0].tolist() == [2.0]
    record.end()
    record.add(state(2.5), OPENINGS)
    assert record.readings()[0].tolist() == [2.0], "open hands that leave do not carry the cloth"
    record.forget()
    record.add(state(3.0), OPENINGS)
    assert len(record.readings()[0]) == 0


def test_a_hand_that_came_free_late_clung_to_the_cloth_until_then():
    record = HandRecord()
    record.freed(Side.LEFT)
    assert not record.clung_until, "nothing was carried"
    record.begin()
    record.add(state(1.0), OPENINGS)
    record.add(state(3.0), OPENINGS)
    record.freed(Side.LEFT)
    record.add(state(4.0), OPENINGS)
    assert record.clung_until == {Side.LEFT: 3.0}
    record.begin()
    assert not record.clung_until


def test_a_motion_of_the_arms_is_recorded_with_both_grippers():
    """After an arm has fallen with cloth in its hand, these readings tell where the cloth was lost."""
    cell = FakeCell(q=np.full(14, 0.2))
    cell.openings = {Side.LEFT: 0.002, Side.RIGHT: 0.003}
    hands = fake_workcell(cell).hands
    hands.record.begin()
    watch = hands.recording()
    for _ in range(3):
        cell.now += 0.01
        assert watch(Tick(cell.now, hands.ports.arms.state())) is None
    t, joints, openings = hands.record.readings()
    assert len(t) == 3 and (joints == 0.2).all()
    np.testing.assert_array_equal(openings, [[0.002, 0.003]] * 3)
