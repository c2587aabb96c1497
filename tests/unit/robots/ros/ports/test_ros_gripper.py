"""Baxter's gripper: one command at a time, repeated until the robot acknowledges it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import pytest
from puppet import Connect, Hand, HandClock, Puppet, wait

from foldcell.robots.baxter.ros.ports.gripper import RosGripper
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Side
from foldcell.robots.ros.node import Node

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy
FULL = 0.0416


class Bench:
    """The left gripper and its driver, with a clock that a test sets."""

    def __init__(self, puppet: Puppet, node: Node) -> None:
        self.puppet, self.clock = puppet, HandClock()
        self.hand: Hand = puppet.hands[Side.LEFT]
        self.port = RosGripper(node, self.clock, Side.LEFT)
        wait(lambda: puppet.hears(self.hand.topic), "it is heard")
        wait(lambda: self.port.hearing.newest, "it hears")

    def done(self) -> None:
        wait(lambda: not self.port.state().moving, "everything is done")

    def calibrate(self) -> None:
        self.port.calibrate()
        self.done()

    def handled(self) -> list[tuple]:
        """The commands that the gripper handled, with their values."""
        figures = {"go": ("position",), "configure": ("moving_force", "holding_force")}
        told = [(m.command, json.loads(m.args or "{}")) for m in self.hand.handled]
        return [(what, *(values[name] for name in figures.get(what, ()))) for what, values in told]

    def pass_time(self, seconds: float, step: float = 0.06) -> None:
        """Advance the clock in small steps, with gripper states in between."""
        until = self.clock.time + seconds
        while self.clock.time < until:
            self.clock.time += step
            wait(lambda: self.port.state().stamp == self.clock.time, "its state")


@pytest.fixture
def bench(puppet: Puppet, node: Node) -> Iterator[Bench]:
    yield Bench(puppet, node)


def fault(port: RosGripper, opening: float = 0.02, force: float = 6.0) -> str:
    with pytest.raises(DriverError) as caught:
        port.command(opening, force)
    assert caught.value.kind is FailureKind.GRIPPER_FAULT
    return caught.value.what


def test_a_gripper_is_calibrated_configured_and_moved_in_this_order(bench: Bench) -> None:
    bench.port.calibrate()
    bench.port.command(FULL / 2, 12.0)
    bench.done()
    assert bench.handled() == [
        ("calibrate",), ("configure", pytest.approx(40.0), pytest.approx(40.0)), ("go", pytest.approx(50.0)),
    ]  # fmt: skip
    assert {m.id for m in bench.hand.handled} == {65538}
    assert bench.port.state().opening == pytest.approx(FULL / 2)


def test_a_command_is_repeated_until_it_is_echoed_and_never_after(bench: Bench, puppet: Puppet) -> None:
    bench.calibrate()
    bench.hand.deaf = True
    bench.port.command(0.02, 6.0)
    bench.pass_time(0.5)
    wait(lambda: len(bench.hand.heard) >= 6, "it is told again and again")
    told = bench.hand.heard[-5:]
    assert {(m.command, m.sender, m.sequence, m.args) for m in told} == {
        (told[0].command, told[0].sender, told[0].sequence, told[0].args)
    }
    bench.hand.deaf = False
    while bench.port.state().moving:
        bench.pass_time(0.06)
    puppet.let(10)
    count = len(bench.hand.heard)
    bench.pass_time(2.0)
    puppet.stays(lambda: len(bench.hand.heard))
    assert len(bench.hand.heard) == count


def test_a_command_is_not_repeated_before_an_answer_is_possible(bench: Bench, puppet: Puppet) -> None:
    bench.calibrate()
    bench.hand.deaf = True
    before = len(bench.hand.heard)
    bench.port.command(0.02, 6.0)
    puppet.let(20)
    assert len(bench.hand.heard) == before + 1


def test_the_force_is_configured_only_when_it_changes(bench: Bench) -> None:
    bench.calibrate()
    for opening, force in ((0.01, 6.0), (0.02, 6.0), (0.01, 3.0), (0.03, 3.0), (0.02, 6.0)):
        bench.port.command(opening, force)
        bench.done()
    assert [h[0] for h in bench.handled()] == [
        "calibrate", "configure", "go", "go", "configure", "go", "go", "configure", "go",
    ]  # fmt: skip


at_once_or_not = pytest.mark.parametrize("at_once", [True, False], ids=["at once", "when it is done"])
"""Whether the next command waits for the end of the calibration. The executive does not wait."""


@at_once_or_not
def test_a_repeated_command_is_sent_only_after_a_new_calibration(
    bench: Bench, puppet: Puppet, at_once: bool
) -> None:
    bench.calibrate()
    for _ in range(5):
        bench.port.command(0.02, 6.0)
    bench.done()
    bench.port.command(0.02, 6.0)
    puppet.let(10)
    assert len(bench.handled()) == 3
    bench.port.calibrate() if at_once else bench.calibrate()
    bench.port.command(0.02, 6.0)
    bench.done()
    done = [h[0] for h in bench.handled()]
    assert done == ["calibrate", "configure", "go", "clear_calibration", "calibrate", "configure", "go"]
    assert bench.port.state().calibrated


def test_openings_and_forces_are_clipped_to_the_gripper_limits(bench: Bench) -> None:
    bench.calibrate()
    bench.port.command(1.0, 1000.0)
    bench.done()
    bench.port.command(-1.0, -1.0)
    bench.done()
    assert [h[1] for h in bench.handled()[1:]] == [100.0, 100.0, 0.0, 0.0]


def test_a_deaf_gripper_is_a_fault_after_a_while(bench: Bench) -> None:
    bench.calibrate()
    bench.hand.deaf = True
    bench.port.command(0.02, 6.0)
    bench.pass_time(1.9)
    bench.port.command(0.03, 6.0)
    bench.pass_time(0.2)
    assert "left" in fault(bench.port)
    bench.port.command(0.03, 6.0)  # the gripper may hear again
    bench.pass_time(2.1)
    assert "left" in fault(bench.port, 0.01)
    bench.hand.deaf = False
    bench.calibrate()
    bench.port.command(0.02, 6.0)


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_command_that_is_not_a_number_is_refused(bench: Bench, wrong: float) -> None:
    bench.calibrate()
    fault(bench.port, wrong, 6.0)
    fault(bench.port, 0.02, wrong)
    assert not bench.port.state().moving


def test_the_gripper_state_is_in_metres_and_newtons(bench: Bench, puppet: Puppet) -> None:
    bench.hand.position, bench.hand.force, bench.hand.moving, bench.hand.calibrated = 25.0, 40.0, 1, 1
    wait(lambda: bench.port.state().calibrated, "heard")
    state = bench.port.state()
    assert (state.opening, state.force) == (pytest.approx(FULL / 4), pytest.approx(12.0))
    assert state.moving and state.side is Side.LEFT and state.stamp == bench.clock.now()
    bench.hand.moving, bench.hand.calibrated = 0, 2
    bench.done()
    assert not bench.port.state().calibrated


def test_an_answer_to_another_program_is_ignored(puppet: Puppet, connect: Connect) -> None:
    """Both programs start with the same sequence number."""
    hand = puppet.hands[Side.LEFT]
    for n in (1, 2):
        with connect() as ports:
            hand.deaf = n == 2
            ports.grippers[Side.LEFT].calibrate()
            puppet.let(10)
            assert ports.grippers[Side.LEFT].state().moving == hand.deaf
            hand.deaf = False
            wait(lambda n=n: len(hand.handled) == 2 * n - 1, "it is calibrated")
            wait(lambda ports=ports: not ports.grippers[Side.LEFT].state().moving, "it is done")
    assert [m.command for m in hand.handled] == ["calibrate", "clear_calibration", "calibrate"]


def test_each_side_has_its_own_gripper(puppet: Puppet, connect: Connect) -> None:
    with connect() as ports:
        left, right = (ports.grippers[side] for side in (Side.LEFT, Side.RIGHT))
        right.calibrate()
        right.command(FULL, 6.0)
        wait(lambda: not right.state().moving, "done")
        assert right.state().calibrated and not left.state().calibrated
        assert puppet.hands[Side.LEFT].heard == []
        assert right.state().opening == pytest.approx(FULL) == right.max_opening


@at_once_or_not
@pytest.mark.parametrize("calibrated", [False, True], ids=["new", "calibrated"])
def test_a_gripper_in_error_is_reset_before_it_is_calibrated(
    bench: Bench, puppet: Puppet, calibrated: bool, at_once: bool
) -> None:
    bench.hand.error, bench.hand.calibrated = 1, int(calibrated)
    puppet.let(10)
    assert bench.port.state().in_error
    bench.port.calibrate() if at_once else bench.calibrate()
    assert not bench.port.state().in_error, "the calibration ends the error"
    bench.port.command(0.02, 6.0)
    bench.done()
    cleared = ["clear_calibration"] * calibrated
    assert [h[0] for h in bench.handled()] == ["reset", *cleared, "calibrate", "configure", "go"]
    assert bench.port.state().calibrated and bench.port.state().opening == pytest.approx(0.02)
