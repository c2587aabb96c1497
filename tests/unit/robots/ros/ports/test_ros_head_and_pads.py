"""The head turns until it arrives. Tactile readings are read as they arrive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from puppet import HEAD, PADS, HandClock, Puppet, pads, wait

from foldcell.robots.baxter.ros.ports.tactile import RosTactile
from foldcell.robots.ports import Ports, Side
from foldcell.robots.ros.node import Node

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy
LEFT = Side.LEFT


# the head ----------------------------------------------------------------------------------------------


def test_the_head_is_commanded_until_it_arrives(puppet: Puppet, ports: Ports) -> None:
    puppet.deaf.add(HEAD)
    ports.head.command_pan(0.4)
    wait(lambda: len(puppet.heard[HEAD]) >= 4, "it is told again and again")
    puppet.deaf.clear()
    wait(lambda: abs(ports.arms.state().head_pan - 0.4) < 1e-6, "it is there")
    puppet.stays(lambda: len(puppet.heard[HEAD]))
    message = puppet.heard[HEAD][-1]
    assert message.target == pytest.approx(0.4) and 0.0 < message.speed_ratio <= 1.0
    assert message.enable_pan_request == 1


# the pads ----------------------------------------------------------------------------------------------


@pytest.fixture
def tactile(puppet: Puppet, node: Node) -> tuple[RosTactile, HandClock]:
    clock = HandClock()
    port = RosTactile(node, clock, LEFT, 4)
    wait(lambda: port.hearing.newest, "a reading")
    return port, clock


def test_tactile_cells_are_arranged_as_on_the_pads(tactile: tuple[RosTactile, HandClock]) -> None:
    reading = tactile[0].reading()
    assert reading.side is LEFT and reading.stamp == 100.0
    np.testing.assert_array_equal(reading.cells, np.arange(24.0).reshape(2, 4, 3))
    np.testing.assert_array_equal(reading.tip, [0.5, 1.5])
    assert reading.grip == np.arange(12.0).sum()
    assert not reading.cells.flags.writeable and not reading.tip.flags.writeable


MALFORMED = {
    "a pad is missing": {"pad_1": None},
    "the tips are missing": {"tips": None},
    "the pads differ": {"pad_0": [1.0] * 8},
    "no whole rows": {"pad_0": [1.0] * 10, "pad_1": [1.0] * 10},
    "three tips": {"tips": [1.0] * 3},
    "no cells": {"pad_0": [], "pad_1": []},
    "a cell is no number": {"pad_0": [*[1.0] * 11, np.nan]},
    "a cell is infinite": {"pad_1": [np.inf, *[1.0] * 11]},
    "a tip is no number": {"tips": [1.0, np.nan]},
    "a column fewer": {"pad_0": [1.0] * 8, "pad_1": [1.0] * 8},
    "one column of three": {"pad_0": [1.0] * 4, "pad_1": [1.0] * 4},
}


@pytest.mark.parametrize("channels", MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_tactile_message_is_ignored(
    puppet: Puppet, tactile: tuple[RosTactile, HandClock], channels: dict
) -> None:
    port, clock = tactile
    puppet.pads[LEFT] = pads(**channels)
    puppet.let(10)
    clock.time += 5.0
    puppet.let(10)
    assert port.reading().stamp == 100.0
    np.testing.assert_array_equal(port.reading().cells, np.arange(24.0).reshape(2, 4, 3))
    puppet.pads[LEFT] = pads()
    wait(lambda: port.reading().stamp == 105.0, "a whole message")


def test_other_tactile_channels_and_sizes_are_read(puppet: Puppet, node: Node) -> None:
    puppet.pads[LEFT] = pads(temperature=[30.0], pad_0=[1.0] * 10, pad_1=[2.0] * 10)
    port = RosTactile(node, HandClock(), LEFT, 5)
    wait(lambda: port.hearing.newest, "a reading")
    assert port.reading().cells.shape == (2, 5, 2) and port.reading().grip == 10.0


def test_the_reading_of_silent_pads_ages(puppet: Puppet, tactile: tuple[RosTactile, HandClock]) -> None:
    port, clock = tactile
    puppet.hush(PADS[LEFT])
    clock.time += 5.0
    puppet.let(10)
    assert port.reading().stamp == 100.0


def test_the_reading_before_the_first_message_has_no_valid_time(puppet: Puppet, node: Node) -> None:
    puppet.hush(PADS[LEFT])
    reading = RosTactile(node, HandClock(), LEFT, 4).reading()
    assert reading.stamp == -np.inf and np.isnan(reading.cells).all() and np.isnan(replace(reading).tip).all()
