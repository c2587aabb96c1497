"""The stop: it works immediately from any thread, is repeated until the robot has stopped, and ends only by a
reset."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from puppet import ENABLE, LIMB, RESET, STATE, STOP, Connect, Puppet, wait

from foldcell.robots.baxter.ros.ports import stop as stop_module
from foldcell.robots.baxter.ros.ports.clock import WallClock
from foldcell.robots.baxter.ros.ports.stop import RosStop
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import Ports, Side
from foldcell.robots.ros.node import Node

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy
ZERO = np.zeros(14)


@pytest.fixture
def stop(puppet: Puppet, node: Node) -> Iterator[RosStop]:
    made = RosStop(node, WallClock())
    wait(lambda: puppet.hears(STOP) and puppet.hears(RESET), "it is heard")
    wait(lambda: made.robot.newest, "it hears")
    yield made
    made.close()


def stopped_by(stop: RosStop, reason: str) -> None:
    stop.trigger(reason)
    wait(lambda: stop.robot.newest.stopped, "stopped")


def on_a_thread(work) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


# triggering --------------------------------------------------------------------------------------------


def test_another_thread_stops_the_robot(puppet: Puppet, ports: Ports) -> None:
    ports.arms.enable()
    assert not ports.stop.state().stopped
    on_a_thread(lambda: ports.stop.trigger("from a thread")).join(60.0)
    state = ports.stop.state()
    assert state.stopped and state.reason == "from a thread"
    wait(lambda: puppet.stopped and not puppet.enabled, "the robot has stopped")


def test_a_stop_is_repeated_until_the_robot_has_stopped(puppet: Puppet, stop: RosStop) -> None:
    puppet.deaf.add(STOP)
    stop.trigger("a test")
    wait(lambda: len(puppet.heard[STOP]) >= 5, "it is told again and again")
    puppet.deaf.clear()
    wait(lambda: puppet.stopped, "stopped")
    puppet.stays(lambda: len(puppet.heard[STOP]))


def test_a_stop_is_sent_to_a_robot_that_is_already_stopped(puppet: Puppet, stop: RosStop) -> None:
    puppet.stopped = True
    wait(lambda: stop.state().stopped, "seen")
    puppet.hush(STATE)
    stop.trigger("a test")
    wait(lambda: puppet.heard[STOP], "told")


def test_the_first_reason_of_a_stop_is_kept(puppet: Puppet, stop: RosStop) -> None:
    stopped_by(stop, "the first")
    stamp = stop.state().stamp
    stop.trigger("the second")
    assert (stop.state().reason, stop.state().stamp) == ("the first", stamp)
    puppet.stays(lambda: len(puppet.heard[STOP]))


def test_a_stop_without_a_reason_works(stop: RosStop) -> None:
    stop.trigger("")
    assert stop.state().stopped and stop.state().reason


def test_triggering_a_stop_never_blocks(puppet: Puppet, stop: RosStop) -> None:
    puppet.deaf.add(STOP)

    def many() -> None:
        for _ in range(70_000):
            stop.trigger("again and again")

    thread = on_a_thread(many)
    thread.join(60.0)
    assert not thread.is_alive()
    puppet.deaf.clear()
    wait(lambda: puppet.stopped, "stopped")


def test_a_signal_handler_can_stop_the_robot_at_any_point(puppet: Puppet, ports: Ports) -> None:
    main = threading.main_thread().ident
    handled = []

    def handler(*_: object) -> None:
        handled.append(1)
        ports.stop.trigger("a signal")

    before = signal.signal(signal.SIGUSR1, handler)
    try:
        for k in range(12):
            ports.stop.reset()
            ports.arms.enable()
            send = threading.Timer(0.005 * k, signal.pthread_kill, (main, signal.SIGUSR1))
            send.start()
            with pytest.raises(DriverError) as caught:
                while True:
                    ports.head.command_pan(0.1)
                    ports.arms.command(ports.arms.state().q, ZERO)
                    ports.grippers[Side.LEFT].calibrate()
                    ports.grippers[Side.LEFT].command(0.02, 5.0)
                    ports.tactile[Side.LEFT].reading()
                    ports.clock.sleep_until(ports.clock.now() + 0.001)
            assert caught.value.kind is FailureKind.STOPPED
            assert len(handled) == k + 1 and ports.stop.state().reason == "a signal"
            wait(lambda: puppet.stopped, "the robot has stopped")
            send.join()
        signal.raise_signal(signal.SIGUSR1)
        assert len(handled) == 13
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_a_signal_while_resetting_stops_again(puppet: Puppet, stop: RosStop, monkeypatch) -> None:
    monkeypatch.setattr(stop_module, "RESET_S", 60.0)
    stopped_by(stop, "the first")
    puppet.deaf.add(RESET)
    before = signal.signal(signal.SIGUSR1, lambda *_: stop.trigger("the second"))
    main = threading.main_thread().ident

    def press() -> None:
        wait(lambda: puppet.heard[RESET], "it is being reset")
        puppet.deaf.add(STOP)
        signal.pthread_kill(main, signal.SIGUSR1)

    thread = on_a_thread(press)
    try:
        with pytest.raises(DriverError, match="the second") as caught:
            stop.reset()
        assert caught.value.kind is FailureKind.STOPPED
    finally:
        thread.join(60.0)
        signal.signal(signal.SIGUSR1, before)
    assert stop.state().stopped and stop.state().reason == "the second"
    puppet.deaf.clear()
    puppet.stopped = False
    wait(lambda: not stop.robot.newest.stopped, "somebody else has reset it")
    stop.trigger("a third")
    wait(lambda: puppet.stopped, "the robot is told of it")
    assert stop.state().reason == "the second"
    stop.reset()
    assert not stop.state().stopped


# closing -----------------------------------------------------------------------------------------------


def test_a_stop_right_before_closing_reaches_the_robot(puppet: Puppet, connect: Connect) -> None:
    for _ in range(5):
        puppet.stopped = False
        with connect() as ports:
            puppet.deaf.add(STOP)
            ports.stop.trigger("and away")
            puppet.deaf.discard(STOP)
        wait(lambda: puppet.stopped, "stopped", 5.0)


def test_closing_does_not_wait_for_a_robot_that_never_stops(puppet: Puppet, node: Node) -> None:
    puppet.deaf.add(STOP)
    stop = RosStop(node, WallClock())
    stop.trigger("a test")
    closing = on_a_thread(stop.close)
    closing.join(60.0)
    assert not closing.is_alive()


def test_a_stop_after_closing_does_nothing(puppet: Puppet, node: Node) -> None:
    stop = RosStop(node, WallClock())
    stop.close()
    stop.close()
    stop.trigger("too late")
    assert stop.state().stopped and stop.state().reason == "too late"
    assert not any(thread.name == "stop" for thread in threading.enumerate())


def test_closing_leaves_no_file_open(puppet: Puppet, node: Node) -> None:
    from pathlib import Path

    def pipes() -> int:
        return sum("pipe:" in str(fd.readlink()) for fd in Path("/proc/self/fd").iterdir() if fd.is_symlink())

    before = pipes()
    stop = RosStop(node, WallClock())
    assert pipes() == before + 2
    stop.trigger("a test")
    stop.close()
    assert pipes() == before


# the robot's reports -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "reason"), [(1, "button"), (3, "fault"), (4, "computer"), (0, "reports that it is stopped")]
)
def test_a_stop_reported_by_the_robot_has_its_reason(
    puppet: Puppet, stop: RosStop, source: int, reason: str
) -> None:
    puppet.button, puppet.source, puppet.stopped = int(source == 1), source, True
    wait(lambda: stop.state().stopped, "seen")
    assert reason in stop.state().reason
    puppet.source = 3 if source == 4 else 4
    puppet.let(10)
    assert reason in stop.state().reason, "the first reason stays"
    assert puppet.heard[STOP] == []


@pytest.mark.parametrize("triggered", [True, False])
def test_a_stop_stays_when_the_robot_no_longer_reports_it(puppet: Puppet, ports: Ports, triggered: bool) -> None:
    ports.arms.enable()
    if triggered:
        ports.stop.trigger("a test")
    else:
        puppet.button, puppet.source, puppet.stopped, puppet.enabled = 1, 1, True, False
    wait(lambda: ports.stop.state().stopped and puppet.stopped, "stopped")
    puppet.let(10)
    puppet.button, puppet.source, puppet.stopped, puppet.enabled = 0, 0, False, True
    puppet.let(10)
    assert ports.stop.state().stopped
    with pytest.raises(DriverError) as caught:
        ports.arms.command(puppet.q, ZERO)
    assert caught.value.kind is FailureKind.STOPPED


def test_the_stamp_of_an_unstopped_state_is_that_of_the_last_message(puppet: Puppet, stop: RosStop) -> None:
    puppet.hush(STATE)
    state = stop.state()
    puppet.let(10)
    assert not state.stopped and stop.state().stamp == state.stamp == stop.robot.newest.stamp


# resetting ---------------------------------------------------------------------------------------------


def test_a_reset_is_refused_while_the_button_is_pressed(puppet: Puppet, stop: RosStop) -> None:
    puppet.button, puppet.source, puppet.stopped = 1, 1, True
    wait(lambda: stop.state().stopped, "seen")
    with pytest.raises(DriverError, match="pressed") as caught:
        stop.reset()
    assert caught.value.kind is FailureKind.STOPPED and stop.state().stopped
    puppet.let(10)
    assert puppet.heard[RESET] == []
    puppet.button = 3
    wait(lambda: stop.robot.newest.button == 3, "released")
    assert stop.state().stopped
    stop.reset()
    assert not stop.state().stopped and not puppet.stopped


def test_after_a_reset_the_arms_are_off_and_nothing_rearms(puppet: Puppet, ports: Ports) -> None:
    ports.arms.enable()
    ports.stop.trigger("a test")
    wait(lambda: puppet.stopped, "stopped")
    enabling = len(puppet.heard[ENABLE])
    ports.stop.reset()
    assert not ports.stop.state().stopped
    puppet.let(20)
    assert not puppet.enabled and not puppet.stopped and len(puppet.heard[ENABLE]) == enabling
    assert puppet.heard[LIMB[Side.LEFT] + "joint_command"] == []
    with pytest.raises(DriverError, match="motors are off"):
        ports.arms.command(puppet.q, ZERO)
    puppet.stays(lambda: (len(puppet.heard[STOP]), len(puppet.heard[RESET])))
    ports.arms.enable()
    ports.arms.command(puppet.q, ZERO)


def test_a_stop_works_again_after_each_reset(puppet: Puppet, stop: RosStop) -> None:
    for k in range(4):
        stopped_by(stop, f"number {k}")
        assert stop.state().reason == f"number {k}"
        stop.reset()
        assert not stop.state().stopped
        puppet.let(3)
        assert not stop.state().stopped


def test_a_failed_reset_leaves_the_stop_unchanged(puppet: Puppet, stop: RosStop, monkeypatch) -> None:
    monkeypatch.setattr(stop_module, "RESET_S", 0.3)
    puppet.deaf |= {STOP, RESET}
    puppet.enabled = True
    stop.trigger("nobody hears it")
    with pytest.raises(DriverError, match="does not leave") as caught:
        stop.reset()
    assert caught.value.kind is FailureKind.STOPPED
    assert stop.state().stopped and stop.state().reason == "nobody hears it"
    told = len(puppet.heard[STOP])
    wait(lambda: len(puppet.heard[STOP]) > told + 5, "the robot is told again")


def test_nothing_moves_during_a_reset(puppet: Puppet, ports: Ports, monkeypatch) -> None:
    monkeypatch.setattr(stop_module, "RESET_S", 60.0)
    ports.arms.enable()
    ports.stop.trigger("a test")
    wait(lambda: puppet.stopped, "stopped")
    puppet.deaf.add(RESET)
    resetting = on_a_thread(ports.stop.reset)
    wait(lambda: len(puppet.heard[RESET]) > 2, "it is being reset")
    assert ports.stop.state().stopped
    with pytest.raises(DriverError, match="a test"):
        ports.arms.enable()
    puppet.deaf.clear()
    resetting.join(60.0)
    assert not resetting.is_alive() and not ports.stop.state().stopped


def test_an_old_state_of_a_silent_robot_does_not_end_a_stop(puppet: Puppet, stop: RosStop, monkeypatch) -> None:
    monkeypatch.setattr(stop_module, "RESET_S", 0.3)
    puppet.hush(STATE)
    assert not stop.robot.newest.stopped and not stop.robot.newest.enabled
    stop.trigger("a test")
    with pytest.raises(DriverError, match="does not leave"):
        stop.reset()
    assert stop.state().stopped


def test_a_persistent_fault_is_reported(puppet: Puppet, stop: RosStop, monkeypatch) -> None:
    monkeypatch.setattr(stop_module, "RESET_S", 0.3)
    puppet.stopped = puppet.error = True
    puppet.deaf.add(RESET)
    wait(lambda: stop.state().stopped, "seen")
    with pytest.raises(DriverError, match="display"):
        stop.reset()


def test_a_remaining_error_does_not_prevent_the_reset_of_a_stop(
    puppet: Puppet, stop: RosStop, monkeypatch
) -> None:
    """A robot can be enabled in spite of an error. The robot itself decides this."""
    monkeypatch.setattr(stop_module, "RESET_S", 0.3)
    stop.trigger("a test")
    wait(lambda: puppet.stopped, "stopped")
    puppet.lasting_error = True
    stop.reset()
    assert not stop.state().stopped and stop.robot.newest.error
