"""Enabling, stopping, resetting and the emergency button, over the fake cell's ports."""

from __future__ import annotations

import numpy as np
import pytest

from foldcell.robots.baxter.emulator.motors import Button, Motors, MotorState
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Array, JointSetpoint
from tests.fakes import FakeCell

HERE = np.zeros(14)


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell()


@pytest.fixture
def motors(cell: FakeCell) -> Motors:
    ports = cell.ports()
    return Motors(ports.arms, ports.stop)


def command(motors: Motors) -> None:
    motors.command(HERE, np.zeros(14))


def test_motors_are_off_until_enabled_and_after_disabling(motors: Motors, cell: FakeCell) -> None:
    command(motors)
    assert cell.commands == []
    assert motors.enable()
    assert motors.state() == MotorState(True, False, Button.UNPRESSED)
    assert not motors.enable()  # the motors were on already
    command(motors)
    assert len(cell.commands) == 1
    motors.disable()
    command(motors)
    assert len(cell.commands) == 1 and not motors.state().enabled


def test_enabling_reaches_arms_that_a_restored_cell_has_switched_off(
    cell: FakeCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    ports, calls = cell.ports(), list[bool]()
    monkeypatch.setattr(ports.arms, "enable", lambda: calls.append(True))
    motors = Motors(ports.arms, ports.stop)
    assert motors.enable() and not motors.enable()
    assert len(calls) == 2


def test_a_stop_switches_the_motors_off_and_a_reset_leaves_them_off(motors: Motors, cell: FakeCell) -> None:
    motors.enable()
    motors.stop("test")
    assert motors.state() == MotorState(False, True, Button.UNPRESSED)
    assert not motors.enable()
    command(motors)  # the fake raises an error if a stopped robot is commanded
    motors.reset(motors.stops)
    assert motors.state() == MotorState(False, False, Button.UNPRESSED)
    assert motors.enable()


def test_a_reset_switches_off_the_motors_of_a_running_robot(motors: Motors) -> None:
    motors.enable()
    motors.reset(motors.stops)
    assert motors.state() == MotorState(False, False, Button.UNPRESSED)


def test_a_reset_is_refused_while_the_button_is_pressed(motors: Motors) -> None:
    motors.enable()
    motors.press()
    assert motors.state() == MotorState(False, True, Button.PRESSED)
    motors.reset(motors.stops)
    assert motors.state() == MotorState(False, True, Button.PRESSED)
    motors.release()
    assert motors.state() == MotorState(False, True, Button.RELEASED)
    motors.reset(motors.stops)
    assert motors.state() == MotorState(False, False, Button.UNPRESSED)
    motors.release()  # the button is not pressed
    assert motors.state().button is Button.UNPRESSED


@pytest.mark.parametrize("how", ["stop", "press"])
def test_a_reset_does_not_lift_a_stop_that_came_after_its_request(motors: Motors, how: str) -> None:
    asked = motors.stops
    motors.stop("now") if how == "stop" else motors.press()
    motors.release()
    motors.reset(asked)
    assert motors.state().stopped


def test_arms_that_refuse_a_command_are_not_enabled(cell: FakeCell, monkeypatch: pytest.MonkeyPatch) -> None:
    ports = cell.ports()
    motors = Motors(ports.arms, ports.stop)
    motors.enable()

    def refuse(q: Array, qd: Array) -> JointSetpoint:
        raise DriverError(FailureKind.HARDWARE_FAULT, "a board does not answer")

    monkeypatch.setattr(ports.arms, "command", refuse)
    command(motors)
    assert not motors.state().enabled
