"""Opening a cell: everything answers, or an error names the silent topics; closing releases everything."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from puppet import CAMERA, COMMANDS, HAND, JOINTS, LIMB, PADS, STATE, Connect, Puppet, wait

from foldcell.robots.baxter.ros import connection
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Side
from foldcell.robots.ros.node import Node, master_address, open_node
from tests.rosmaster import free_port

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy
LEFT, RIGHT = Side.LEFT, Side.RIGHT
HEARD = [JOINTS, STATE, *(HAND[s] + "state" for s in Side), *(PADS[s] for s in Side)]


def refusal(connect: Connect, **settings: object) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught, connect(**settings):
        pass
    return caught.value


def test_a_robot_on_all_topics_is_opened_as_a_cell(connect: Connect) -> None:
    with connect() as ports:
        assert ports.driver == "ros" and not ports.simulated
        assert ports.arms.state().stamp <= ports.clock.now()
        assert not ports.stop.state().stopped
        for side in Side:
            assert ports.grippers[side].side is ports.tactile[side].side is side
            assert np.isfinite(ports.grippers[side].state().opening)
            assert ports.tactile[side].reading().cells.shape == (2, 4, 3)


def test_all_silent_topics_are_named_in_one_error(puppet: Puppet, connect: Connect, monkeypatch) -> None:
    monkeypatch.setattr(connection, "ANSWER_S", 2.5)
    silent = {STATE, HAND[RIGHT] + "state", PADS[LEFT]}
    puppet.silent = set(silent)
    error = refusal(connect)
    assert {topic for topic in HEARD if topic in error.what} == silent
    assert master_address()[0] in error.hint


def test_pads_with_another_message_format_count_as_silent(connect: Connect, monkeypatch) -> None:
    monkeypatch.setattr(connection, "ANSWER_S", 2.5)
    error = refusal(connect, tactile_rows=5)
    assert [topic for topic in HEARD if topic in error.what] == [PADS[LEFT], PADS[RIGHT]]


def test_a_missing_simulated_clock_is_named(node: Node, connect: Connect, monkeypatch) -> None:
    monkeypatch.setattr(connection, "ANSWER_S", 2.5)
    node.set_parameter("/use_sim_time", True)
    try:
        error = refusal(connect)
    finally:
        node.delete_parameter("/use_sim_time")
    assert "/clock" in error.what and not any(topic in error.what for topic in HEARD)


@pytest.fixture
def second_robot(rosmaster: str) -> Iterator[None]:
    program = textwrap.dedent("""
        import sys
        from foldcell.robots.ros.installation import import_ros
        from foldcell.robots.baxter.ros.messages import load_messages
        rospy = import_ros()
        rospy.init_node("second_robot", disable_signals=True, disable_rosout=True, disable_rostime=True)
        publisher = rospy.Publisher("/robot/state", load_messages().assembly_state, queue_size=1)
        print("ready", flush=True)
        sys.stdin.read()
        rospy.signal_shutdown("over")
    """)
    robot = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert robot.stdin is not None and robot.stdout is not None
    try:
        assert robot.stdout.readline() == b"ready\n"
        yield
    finally:
        robot.stdin.close()
        robot.wait(60.0)
        robot.stdout.close()


@pytest.mark.usefixtures("second_robot")
def test_two_robots_on_the_network_are_refused(connect: Connect) -> None:
    error = refusal(connect)
    assert error.what.startswith("2 nodes") and "one robot" in error.hint


OPEN_NODE = """
from foldcell.robots.ros.node import open_node
from foldcell.robots.errors import ConfigurationError
try:
    open_node("anybody")
except ConfigurationError as error:
    print(error.what, error.hint, sep="\\n")
"""


@pytest.mark.usefixtures("puppet")
def test_a_missing_master_is_reported_with_its_address() -> None:
    """A child process opens the node, because this process is already a node of another master."""
    uri = f"http://127.0.0.1:{free_port()}"
    environment = {**os.environ, "ROS_MASTER_URI": uri}
    answer = subprocess.run(
        [sys.executable, "-c", OPEN_NODE], env=environment, capture_output=True, text=True, check=True
    )
    what, hint = answer.stdout.splitlines()
    assert "no ROS master answers" in what and uri in what and "ROS_MASTER_URI" in hint


def test_a_process_cannot_become_a_node_of_a_second_master(
    puppet: Puppet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    with pytest.raises(ConfigurationError, match="cannot be one of") as caught:
        open_node("anybody")
    assert master_address()[0] in caught.value.what


@pytest.mark.parametrize("uri", [
    "localhost", "localhost:11311", "http://localhost", "http://localhost:port", "http://[", "http://a..b:11311",
    "http://\udce9:11311",
])  # fmt: skip
def test_an_invalid_master_address_is_refused(monkeypatch: pytest.MonkeyPatch, uri: str) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    with pytest.raises(ConfigurationError, match="is not an address"):
        master_address()


def test_the_default_master_address_is_that_of_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_MASTER_URI", raising=False)
    assert master_address() == ("http://localhost:11311", "localhost", 11311)


def left_over(puppet: Puppet, node: Node) -> list[str]:
    commands = [topic for topic in COMMANDS if node.publishers(topic)]
    heard = [topic for topic in [*HEARD, *CAMERA.values()] if puppet.listeners(topic)]
    return commands + heard


@pytest.mark.parametrize("way", ["ends", "fails", "is refused"])
def test_a_closed_or_refused_connection_releases_everything(
    puppet: Puppet, node: Node, connect: Connect, monkeypatch, way: str
) -> None:
    before = threading.active_count()
    if way == "is refused":
        monkeypatch.setattr(connection, "ANSWER_S", 0.4)
        puppet.silent.add(STATE)
        refusal(connect)
        puppet.silent.clear()
    elif way == "fails":
        with pytest.raises(ZeroDivisionError), connect():
            raise ZeroDivisionError
    else:
        with connect():
            assert left_over(puppet, node) == [*COMMANDS, *HEARD]
    wait(lambda: left_over(puppet, node) == [], "nobody speaks or listens")
    assert not any(thread.name == "stop" for thread in threading.enumerate())
    wait(lambda: threading.active_count() <= before, "its threads have ended")


def test_a_connection_can_be_opened_again(puppet: Puppet, connect: Connect) -> None:
    for n in range(3):
        with connect() as ports:
            ports.arms.enable()
            q = puppet.q + 0.01
            ports.arms.command(q, np.zeros(14))
            heard = puppet.heard[LIMB[LEFT] + "joint_command"]
            wait(lambda n=n, heard=heard: len(heard) == n + 1, "a command")
            ports.stop.trigger("a test")
            wait(lambda: puppet.stopped, "stopped")
            ports.stop.reset()


def test_closing_in_the_middle_of_an_exchange_logs_no_warning(
    puppet: Puppet, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages that arrive during closing are not answered."""
    complaints: list[str] = []

    class Ear(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            complaints.append(record.getMessage())

    ear = Ear(logging.WARNING)
    logging.getLogger("rosout").addHandler(ear)
    monkeypatch.setattr("foldcell.robots.baxter.ros.ports.gripper.REPEAT_S", 0.0)
    monkeypatch.setattr("foldcell.robots.baxter.ros.ports.head.REPEAT_S", 0.0)
    puppet.deaf.add("/robot/head/command_head_pan")
    for hand in puppet.hands.values():
        hand.deaf = True
    try:
        for _ in range(5):
            puppet.stopped = False
            puppet.let(5)
            with connect() as ports:
                ports.head.command_pan(1.0)
                for gripper in ports.grippers.values():
                    gripper.calibrate()
                ports.stop.trigger("a test")
    finally:
        logging.getLogger("rosout").removeHandler(ear)
    # a connection that closes while the puppet still accepts it is reported by the puppet's end, on a busy machine
    assert [text for text in complaints if "before handshake header" not in text] == []


def test_the_stop_is_reset_even_if_nothing_else_answers(puppet: Puppet, monkeypatch) -> None:
    puppet.silent |= {JOINTS, *(HAND[s] + "state" for s in Side), *(PADS[s] for s in Side)}
    puppet.stopped = True
    with connection.connected_stop() as stop:
        wait(lambda: stop.state().stopped, "it is seen")
        stop.reset()
        assert not stop.state().stopped
    assert not puppet.stopped and not puppet.enabled
    monkeypatch.setattr(connection, "ANSWER_S", 0.3)
    puppet.silent.add(STATE)
    with pytest.raises(ConfigurationError, match=STATE), connection.connected_stop():
        pass


def test_the_stop_of_a_simulated_robot_is_reset_in_simulated_time(
    puppet: Puppet, node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock is received before it is used. Otherwise the time would jump."""
    monkeypatch.setattr(connection, "ANSWER_S", 0.3)
    node.set_parameter("/use_sim_time", True)
    try:
        with pytest.raises(ConfigurationError), connection.connected_stop():
            pass
    finally:
        node.delete_parameter("/use_sim_time")
