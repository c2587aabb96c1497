"""The electric gripper's protocol, over a gripper that records its commands."""

from __future__ import annotations

import json
from typing import Any

import pytest

from foldcell.robots.baxter.emulator.grippers import ElectricGripper
from foldcell.robots.baxter.emulator.initial_state import NEW, USED, InitialState
from foldcell.robots.baxter.ros.electric_gripper import FULL_FORCE, HARDWARE_ID
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import GripperState, Side

STROKE = 0.05
"""A stroke that differs from Baxter's, because percentages refer to the port's stroke."""


class Port:
    side = Side.LEFT
    max_opening = STROKE

    def __init__(self) -> None:
        self.calibrated = self.moving = False
        self.opening, self.force = 0.02, 0.0
        self.done: list[Any] = []
        self.broken = False

    def calibrate(self) -> None:
        self.done.append("calibrate")

    def command(self, opening: float, force: float) -> None:
        if self.broken:
            raise DriverError(FailureKind.GRIPPER_FAULT, "it is unplugged")
        self.done.append((pytest.approx(opening), pytest.approx(force)))

    def state(self) -> GripperState:
        return GripperState(3.5, self.side, self.opening, self.force, self.moving, self.calibrated)


class Talk:
    """Sends commands with increasing sequence numbers."""

    def __init__(self, calibrated: bool = True, past: InitialState = NEW) -> None:
        self.port = Port()
        self.port.calibrated = calibrated
        self.gripper = ElectricGripper(self.port, past)
        self.sequence = 0

    def say(self, command: str, args: Any = None, hardware: int = HARDWARE_ID) -> str:
        """Send a command. Returns the reason of a refusal, or an empty text."""
        self.sequence += 1
        text = args if isinstance(args, str) else json.dumps(args) if args is not None else ""
        self.gripper.hear(hardware, command, text, "me", self.sequence)
        return self.gripper.report().refusal


def test_the_gripper_state_is_in_percent_of_its_stroke() -> None:
    talk = Talk()
    talk.port.opening, talk.port.force = 0.2 * STROKE, 0.5 * FULL_FORCE
    report = talk.gripper.report()
    assert (report.stamp, report.calibrated, report.ready, report.moving) == (3.5, True, True, False)
    assert report.position == pytest.approx(20.0) and report.force == pytest.approx(50.0)
    assert report.gripping
    assert (report.command, report.sender, report.sequence, json.loads(report.state)) == ("", "", 0, {})
    talk.port.moving = True
    moving = talk.gripper.report()
    assert moving.moving and not moving.ready and not moving.gripping


def test_go_is_refused_until_the_gripper_is_calibrated() -> None:
    talk = Talk(calibrated=False)
    assert "calibrated" in talk.say("go", {"position": 50})
    report = talk.gripper.report()
    # the command is handled nevertheless
    assert (report.command, report.sender, report.sequence) == ("go", "me", 1)
    assert "calibrated" in json.loads(report.state)["error"]
    assert not talk.say("calibrate")
    talk.port.calibrated = True
    assert not talk.say("go", {"position": 50})
    assert talk.port.done == ["calibrate", (0.5 * STROKE, 0.3 * FULL_FORCE)]


def test_a_gripper_without_a_calibration_is_ready_for_one() -> None:
    """The SDK waits for this state after it has cleared a calibration."""
    talk = Talk()
    assert not talk.say("clear_calibration")
    assert (talk.gripper.report().calibrated, talk.gripper.report().ready) == (False, True)
    assert not talk.say("calibrate")
    talk.port.moving = True
    assert not talk.gripper.report().ready


def test_pads_that_close_on_nothing_have_missed() -> None:
    talk = Talk()
    assert not talk.gripper.report().missed
    talk.say("go", {"position": 0})
    talk.port.moving = True
    assert not talk.gripper.report().missed
    talk.port.moving, talk.port.force = False, 0.5 * FULL_FORCE
    assert talk.gripper.report().gripping and not talk.gripper.report().missed
    talk.port.force = 0.0
    assert talk.gripper.report().missed and not talk.gripper.report().gripping


def test_a_repeated_command_is_done_once() -> None:
    talk = Talk()
    for _ in range(3):
        talk.gripper.hear(HARDWARE_ID, "go", '{"position": 50}', "me", 7)
    assert len(talk.port.done) == 1
    talk.gripper.hear(HARDWARE_ID, "go", '{"position": 50}', "you", 7)
    talk.gripper.hear(HARDWARE_ID, "go", '{"position": 50}', "you", 8)
    assert len(talk.port.done) == 3
    assert (talk.gripper.report().sender, talk.gripper.report().sequence) == ("you", 8)


def test_commands_for_another_hardware_id_are_ignored() -> None:
    talk = Talk()
    talk.say("go", {"position": 50}, hardware=65540)
    assert talk.port.done == [] and talk.gripper.report().sequence == 0


def test_a_gripper_closes_with_the_configured_holding_force() -> None:
    talk = Talk()
    assert not talk.say("configure", {"holding_force": 80.0, "moving_force": 10.0})
    assert not talk.say("configure", {"velocity": 100.0})  # the other values stay
    assert not talk.say("go", {"position": 0})
    assert talk.port.done == [(0.0, 0.8 * FULL_FORCE)]


@pytest.mark.parametrize(
    "args", ["", "{", "[1]", "3", {}, {"position": "9"}, {"position": True}, '{"position": NaN}']
)
def test_an_invalid_go_command_is_refused(args: Any) -> None:
    talk = Talk()
    assert talk.say("go", args)
    assert talk.port.done == []


def test_an_invalid_configuration_changes_nothing() -> None:
    talk = Talk()
    assert talk.say("configure", {"holding_force": 90.0, "velocity": "fast"})
    talk.say("go", {"position": 0})
    assert talk.port.done == [(0.0, 0.3 * FULL_FORCE)]


def test_a_position_beyond_the_stroke_is_clipped() -> None:
    talk = Talk()
    talk.say("go", {"position": 140.0})
    talk.say("go", {"position": -3.0})
    assert [opening for opening, _ in talk.port.done] == [STROKE, 0.0]


def test_a_gripper_stop_holds_its_position_and_its_grip() -> None:
    talk = Talk()
    assert not talk.say("stop")
    assert talk.port.done == []
    talk.port.moving, talk.port.opening = True, 0.013
    talk.say("stop")
    assert talk.port.done == [(0.013, 0.3 * FULL_FORCE)]


def test_unknown_commands_and_broken_ports_are_errors_until_a_reset() -> None:
    talk = Talk()
    assert "dance" in talk.say("dance")
    talk.port.broken = True
    assert talk.say("go", {"position": 1}) == "it is unplugged"
    assert not talk.say("reset")
    assert not talk.say("no_op")
    assert talk.gripper.report().command == "no_op"


def test_a_gripper_is_uncalibrated_during_a_new_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """The port may report the earlier calibration during the new one."""
    talk = Talk()
    monkeypatch.setattr(talk.port, "calibrate", lambda: setattr(talk.port, "moving", True))
    assert not talk.say("clear_calibration")
    assert not talk.gripper.report().calibrated and talk.say("go", {"position": 50})
    assert not talk.say("calibrate")
    assert not talk.gripper.report().calibrated and "calibrated" in talk.say("go", {"position": 50})
    talk.port.moving = False
    assert talk.gripper.report().calibrated and not talk.say("go", {"position": 50})
    talk.port.moving = True  # the gripper moves to the commanded position
    assert talk.gripper.report().calibrated


def test_a_used_gripper_keeps_its_earlier_state() -> None:
    talk = Talk(past=USED)
    report = talk.gripper.report()
    assert (report.sender, report.sequence, report.refusal) == ("another_program_go", 1, "")
    # a late repetition of the same command
    talk.gripper.hear(HARDWARE_ID, "go", '{"position": 0}', "another_program_go", 1)
    assert talk.port.done == []
    talk.say("go", {"position": 0})
    assert talk.port.done == [(0.0, FULL_FORCE)]


def test_a_gripper_in_error_does_nothing_until_a_reset() -> None:
    talk = Talk(past=InitialState(error="over current"))
    assert talk.gripper.report().refusal == "over current"
    for command, arguments in (("calibrate", None), ("configure", {"velocity": 3}), ("go", {"position": 5})):
        assert "over current" in talk.say(command, arguments)
    # the command is handled, and the gripper is still in error
    assert talk.say("clear_calibration") == "over current"
    assert talk.port.done == []
    assert not talk.say("reset")
    assert not talk.say("calibrate") and talk.port.done == ["calibrate"]
