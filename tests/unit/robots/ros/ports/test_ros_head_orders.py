"""When the head is commanded to turn, without a network or a clock."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire import Wire

from foldcell.robots.baxter.ros.ports.head import RosHead
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import JointState
from tests.optional_parts import ROS

pytestmark = ROS.required
LIMIT = 1.39


class Bench:
    """A head that stays where a test puts it, its driver, and a stop."""

    def __init__(self) -> None:
        self.wire, self.stopped, self.pan = Wire(), False, 0.0
        self.port = RosHead(self.wire, self.wire, lambda: self.stopped)  # type: ignore[arg-type]

    def states(self, seconds: float) -> int:
        """Send joint states at 100 Hz. Returns the number of commands to the head meanwhile."""
        told, zero = self.wire.count, np.zeros(14)
        for _ in range(round(100 * seconds)):
            self.wire.time += 0.01
            self.port.watch(JointState(self.wire.time, zero, zero, zero, self.pan))
        return self.wire.count - told


def test_a_head_without_commands_is_not_moved() -> None:
    bench = Bench()
    bench.pan = 0.7
    assert bench.states(10.0) == 0


@given(st.floats(-10.0, 10.0))
def test_the_head_angle_is_clipped_to_its_limits(angle: float) -> None:
    bench = Bench()
    bench.port.command_pan(angle)
    (message,) = bench.wire.told
    assert message.target == max(-LIMIT, min(LIMIT, angle))
    assert message.speed_ratio == 0.5 and message.enable_pan_request == 1


@pytest.mark.parametrize("goal", [-0.5, 0.5])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_head_is_commanded_at_20_hz_until_it_arrives(goal: float, side: float) -> None:
    """This holds from either side, with a tolerance of 5 mrad. A head that is pushed away is commanded again."""
    bench = Bench()
    bench.port.command_pan(goal)
    bench.pan = goal + side * 0.0055
    assert 16 <= bench.states(1.0) <= 20
    bench.pan = goal + side * 0.0045
    assert bench.states(1.0) == 0
    bench.pan = goal + side * 0.3
    assert 16 <= bench.states(1.0) <= 20


def test_the_head_is_commanded_for_five_seconds_after_the_last_command() -> None:
    bench = Bench()
    bench.port.command_pan(0.4)
    bench.states(4.8)
    assert bench.states(0.15) > 0 and bench.states(10.0) <= 1
    bench.port.command_pan(0.4)
    bench.states(3.0)
    bench.port.command_pan(-0.4)
    assert bench.wire.told[-1].target == -0.4
    bench.states(4.8)
    assert bench.states(0.15) > 0 and bench.states(10.0) <= 1
    assert bench.wire.told[-1].target == -0.4


def test_a_head_motion_ended_by_a_stop_does_not_resume_after_the_reset() -> None:
    bench = Bench()
    bench.port.command_pan(0.4)
    assert bench.states(0.3) > 0
    bench.stopped = True
    assert bench.states(0.5) == 0
    bench.stopped = False
    assert bench.states(3.0) == 0
    bench.port.command_pan(0.4)
    assert bench.states(0.3) > 0


def test_a_stopped_head_gets_no_commands() -> None:
    bench = Bench()
    bench.stopped = True
    with pytest.raises(DriverError) as caught:
        bench.port.command_pan(0.4)
    assert caught.value.kind is FailureKind.STOPPED and bench.wire.count == 0
    bench.stopped = False
    assert bench.states(6.0) == 0


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_an_invalid_head_angle_does_not_replace_the_last_one(wrong: float) -> None:
    bench = Bench()
    bench.port.command_pan(0.4)
    with pytest.raises(DriverError) as caught:
        bench.port.command_pan(wrong)
    assert caught.value.kind is FailureKind.HARDWARE_FAULT
    assert bench.states(1.0) > 0 and bench.wire.told[-1].target == 0.4
