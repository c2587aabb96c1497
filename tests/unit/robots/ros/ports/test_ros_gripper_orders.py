"""Gripper commands in any sequence, without a network or a clock."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire import Wire

from foldcell.robots.baxter.ros.electric_gripper import FULL_FORCE, FULL_OPENING
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.baxter.ros.ports.gripper import RosGripper
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Side
from tests.optional_parts import ROS

pytestmark = ROS.required
STATE_S = 0.05
LONG = 40
"""Number of states after which all commands have been executed."""


@dataclass
class Hand:
    """A gripper that handles one command at a time and fails the test on commands that the SDK would not send.

    refuses: the command that it reports as handled with an error, but does not execute.
    """

    calibrated: int = 0
    error: int = 0
    position: float = 40.0
    force: float | None = None
    last: tuple[str, int] = "", 0
    echo: tuple[str, int] = "", 0
    busy: int = 0
    calibrations: int = 0
    deaf: bool = False
    counts: bool = True
    refuses: str = ""
    refused: int = 0

    def hear(self, message: Any) -> None:
        given = message.sender, message.sequence
        if self.deaf or self.busy or given == self.last:
            return
        self.last, self.echo = given, (message.sender, message.sequence if self.counts else 0)
        figures = json.loads(message.args or "{}")
        self.refused = int(message.command == self.refuses)
        if self.refused:
            return
        if message.command == "reset":
            self.error = 0
        assert not self.error, f"{message.command} in error"
        if message.command == "clear_calibration":
            self.calibrated = 0
        elif message.command == "calibrate":
            assert not self.calibrated, (
                "a calibrated gripper is not calibrated again, because its end could not be detected"
            )
            self.busy, self.force = 4, None
            self.calibrations += 1
        elif message.command == "configure":
            self.force = figures["holding_force"]
        elif message.command == "go":
            assert self.calibrated, "go is not sent before the calibration"
            assert self.force is not None, "go is not sent before the force is configured"
            self.position = figures["position"]

    def state(self) -> Any:
        if self.busy:
            self.busy -= 1
            self.calibrated = int(self.busy == 0)
        return load_messages().end_effector_state(
            calibrated=self.calibrated, moving=int(self.busy > 0), ready=self.calibrated,
            error=self.error or self.refused, state='{"why": "a test"}', position=self.position, force=0.0,
            command_sender=self.echo[0], command_sequence=self.echo[1],
        )  # fmt: skip


class Bench:
    """One gripper and its driver. The bench notes the expected end of each command."""

    def __init__(self, calibrated: bool = False, error: bool = False) -> None:
        self.wire, self.hand = Wire(), Hand(int(calibrated), int(error))
        self.stopped = False
        self.port = RosGripper(self.wire, self.wire, Side.LEFT, lambda: self.stopped)  # type: ignore[arg-type]
        self.due = 0
        """Number of calibrations that the hand must have made."""
        self.wanted: tuple[float, float] | None = None
        self.states(1)

    def states(self, count: int) -> None:
        for _ in range(count):
            self.wire.time += STATE_S
            if self.wire.told:
                self.hand.hear(self.wire.told.popleft())
            self.wire.heard(self.hand.state())

    def calibrate(self) -> None:
        if self._refused(self.port.calibrate):
            return
        self.due, self.wanted = self.hand.calibrations + 1, None
        assert self.port.state().moving and not self.port.state().calibrated

    def command(self, opening: float, force: float) -> None:
        if not self.stopped and not self.due and not self.hand.calibrated:
            with pytest.raises(DriverError, match="not calibrated"):
                self.port.command(opening, force)
        elif not self._refused(lambda: self.port.command(opening, force)):
            self.wanted = opening, force

    def stop(self) -> None:
        self.stopped = True
        self.states(1)
        told = self.wire.count
        self.wire.told.clear()
        self.states(8)
        assert self.wire.count == told and not self.port.state().moving
        self.due, self.wanted = 0, None

    def reset(self) -> None:
        """Reset a stopped robot."""
        if self.stopped:
            self.stopped, told = False, self.wire.count
            self.states(8)
            assert self.wire.count == told, "commands that a stop interrupted are void"

    def ends(self) -> None:
        """Assert that all commands are executed in order."""
        self.states(LONG)
        state = self.port.state()
        assert not state.moving and self.hand.calibrations >= self.due
        assert state.calibrated == bool(self.hand.calibrated)
        assert not self.due or state.calibrated
        if self.wanted is not None:
            opening, force = self.wanted
            assert self.hand.position == pytest.approx(100.0 * opening / FULL_OPENING)
            assert self.hand.force == pytest.approx(100.0 * force / FULL_FORCE)
            assert state.opening == pytest.approx(opening)

    def _refused(self, order: Callable[[], None]) -> bool:
        """Whether the robot is stopped and therefore refused the command."""
        if not self.stopped:
            order()
            return False
        with pytest.raises(DriverError) as caught:
            order()
        assert caught.value.kind is FailureKind.STOPPED
        return True


openings, forces = st.sampled_from([0.0, 0.01, FULL_OPENING]), st.sampled_from([3.0, 6.0, 12.0])
deeds = st.one_of(
    st.just(("calibrate",)),
    st.tuples(st.just("command"), openings, forces),
    st.tuples(st.just("states"), st.integers(1, 7)),
    st.sampled_from([("stop",), ("reset",)]),
)


@settings(max_examples=400)
@given(calibrated=st.booleans(), deeds=st.lists(deeds, max_size=12))
def test_the_last_command_of_any_sequence_is_executed(calibrated: bool, deeds: list[tuple]) -> None:
    """This holds for any number of gripper states between two commands."""
    bench = Bench(calibrated)
    for name, *figures in deeds:
        getattr(bench, name)(*figures)
    bench.ends()


@pytest.mark.parametrize("states", range(8))
def test_a_second_calibration_during_the_first_is_executed(states: int) -> None:
    """The end of the first calibration is not taken for the end of the second."""
    bench = Bench()
    bench.calibrate()
    bench.states(states)
    bench.calibrate()
    bench.command(0.01, 6.0)
    bench.ends()


@pytest.mark.parametrize("states", range(10))
def test_a_command_cancelled_by_a_stop_is_not_resumed(states: int) -> None:
    bench = Bench(calibrated=True)
    bench.calibrate()
    bench.command(0.01, 6.0)
    bench.states(states)
    bench.stop()
    bench.reset()
    bench.calibrate()
    bench.command(0.02, 3.0)
    bench.ends()


def test_a_command_given_before_a_stop_can_be_repeated_after_it() -> None:
    bench = Bench(calibrated=True)
    bench.command(0.01, 6.0)
    bench.ends()
    bench.stop()
    bench.hand.position, bench.hand.force = 0.0, None  # a robot without power
    bench.reset()
    bench.command(0.01, 6.0)
    bench.ends()


def test_a_hand_that_echoes_sequence_0_for_all_commands_is_supported() -> None:
    bench = Bench(calibrated=True, error=True)
    bench.hand.counts = False
    bench.calibrate()
    bench.command(0.01, 6.0)
    bench.ends()


def fault(bench: Bench, opening: float = 0.02, force: float = 6.0) -> str:
    with pytest.raises(DriverError) as caught:
        bench.port.command(opening, force)
    assert caught.value.kind is FailureKind.GRIPPER_FAULT
    return caught.value.what


def test_a_refusal_is_reported_once_and_does_not_block_later_commands() -> None:
    bench = Bench(calibrated=True)
    bench.command(0.01, 6.0)
    bench.ends()
    bench.hand.refuses = "go"
    bench.command(0.0, 6.0)
    bench.states(LONG)
    assert not bench.port.state().moving and bench.hand.position == pytest.approx(100.0 * 0.01 / FULL_OPENING)
    what = fault(bench)
    assert "refused to go" in what and "a test" in what
    bench.hand.refuses = ""
    bench.command(0.0, 6.0)  # the same command again, because it was not executed
    bench.ends()


def test_the_pads_do_not_move_after_a_refused_force() -> None:
    bench = Bench(calibrated=True)
    bench.command(0.01, 12.0)
    bench.ends()
    bench.hand.refuses = "configure"
    bench.command(0.0, 3.0)
    bench.states(LONG)
    assert bench.hand.position == pytest.approx(100.0 * 0.01 / FULL_OPENING)
    assert "refused to configure" in fault(bench)
    bench.hand.refuses = ""
    bench.command(0.0, 3.0)
    bench.ends()


@pytest.mark.parametrize("calibrate", [False, True])
def test_a_command_that_timed_out_is_not_executed_later(calibrate: bool) -> None:
    bench = Bench(calibrated=True)
    bench.hand.deaf = True
    if calibrate:
        bench.port.calibrate()
    bench.port.command(0.01, 6.0)
    bench.states(round(12.0 / STATE_S))
    state = bench.port.state()
    assert not state.moving and state.calibrated is not calibrate
    bench.wire.told.clear()
    bench.hand.deaf, told = False, bench.wire.count
    bench.states(LONG)
    assert bench.wire.count == told and bench.hand.position == 40.0
    assert "does not execute the command" in fault(bench)
    if calibrate:
        assert "not calibrated" in fault(bench)
        bench.calibrate()
    bench.command(0.01, 6.0)
    bench.ends()


def test_a_gripper_counts_as_moving_as_soon_as_it_is_commanded(monkeypatch: pytest.MonkeyPatch) -> None:
    """This also holds if a state arrives at the same time: an old state is not combined with a newer queue."""
    bench = Bench(calibrated=True)
    bench.command(0.01, 6.0)
    bench.ends()
    hearing = bench.port.hearing

    class Meanwhile:
        """A state with moving = 1 arrives right after the previous state was read."""

        @property
        def newest(self) -> Any:
            taken = hearing.newest
            bench.hand.hear(bench.wire.told.popleft())
            moving = bench.hand.state()
            moving.moving = 1
            bench.wire.heard(moving)
            return taken

    bench.command(0.02, 6.0)
    monkeypatch.setattr(bench.port, "hearing", Meanwhile())
    assert bench.port.state().moving


def test_a_hand_before_its_first_state_counts_as_not_calibrated() -> None:
    wire = Wire()
    port = RosGripper(wire, wire, Side.LEFT)  # type: ignore[arg-type]
    with pytest.raises(DriverError, match="not calibrated"):
        port.command(0.01, 6.0)
    state = port.state()
    assert state.stamp == -math.inf and math.isnan(state.opening) and not state.calibrated and wire.count == 0


def test_a_command_interrupted_by_a_stop_fails_as_stopped() -> None:
    """The stop voids the calibration that the command waits for, so 'not calibrated' would be misleading."""
    bench = Bench()
    looks = iter([False, True])
    port = RosGripper(bench.wire, bench.wire, Side.LEFT, lambda: next(looks))  # type: ignore[arg-type]
    with pytest.raises(DriverError) as caught:
        port.command(0.01, 6.0)
    assert caught.value.kind is FailureKind.STOPPED


def test_a_calibration_continues_when_another_command_is_echoed() -> None:
    """The robot echoes the last sender. The calibration is not sent again and keeps its time limit of 10 s."""
    bench = Bench()
    bench.calibrate()
    bench.states(2)
    bench.hand.busy = round(6.0 / STATE_S)
    bench.hand.echo, told = ("somebody_else", 7), bench.wire.count
    bench.states(round(3.0 / STATE_S))
    bench.port.command(0.01, 6.0)
    assert bench.wire.count == told and bench.hand.busy > 0


def test_commands_do_not_renew_the_state_of_a_silent_hand() -> None:
    bench = Bench(calibrated=True)
    stamp = bench.port.state().stamp
    assert stamp == bench.wire.now()
    bench.wire.time += 1.0
    bench.port.command(0.01, 6.0)
    bench.port.calibrate()
    assert bench.port.state().stamp == stamp
    bench.states(1)
    assert bench.port.state().stamp == bench.wire.now()


@pytest.mark.parametrize("name", ["position", "force"])
@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_state_with_values_that_are_not_finite_is_ignored(name: str, wrong: float) -> None:
    bench = Bench(calibrated=True)
    before = bench.port.state()
    bench.wire.time += 1.0
    state = bench.hand.state()
    setattr(state, name, wrong)
    state.calibrated = 0
    bench.wire.heard(state)
    assert bench.port.state() == before
