"""Other programs at the robot: a live one that commands the arms is refused, and a dead one is ignored."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from puppet import Connect, wait

from foldcell.robots.baxter.ros.topics import JOINT_COMMAND
from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ports import Side
from foldcell.robots.ros import node as node_module
from foldcell.robots.ros.node import Node

pytestmark = pytest.mark.filterwarnings("ignore:notifyAll")  # a warning of rospy
TOPIC = JOINT_COMMAND.format(Side.LEFT)
OTHER = f"""
from foldcell.robots.baxter.ros.messages import load_messages
from foldcell.robots.ros.node import open_node
node = open_node("other_program")
node.publisher({TOPIC!r}, load_messages().joint_command)
print("there", flush=True)
input()
node.close()
"""


@contextmanager
def another_program() -> Iterator[subprocess.Popen[str]]:
    program = subprocess.Popen(
        [sys.executable, "-c", OTHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert program.stdout is not None and program.stdout.readline() == "there\n"
        yield program
    finally:
        program.kill()
        program.communicate()


def test_another_program_at_the_arms_is_refused_by_name(connect: Connect) -> None:
    with another_program() as program:
        refused = "other programs command the robot's arms: /other_program"
        with pytest.raises(ConfigurationError, match=refused), connect():
            raise AssertionError("two programs at one arm")
        program.communicate("leave\n")
    with connect():
        pass


def test_a_killed_program_does_not_block_the_arms(connect: Connect, node: Node) -> None:
    """The master still lists a killed program."""
    with another_program() as program:
        wait(lambda: len(node.publishers(TOPIC)) == 1, "the other program is known")
        program.send_signal(signal.SIGKILL)
        program.wait()
        assert node.publishers(TOPIC) == []
        with connect():
            pass


@pytest.mark.parametrize(("error", "alive"), [(ConnectionRefusedError(), False), (TimeoutError(), True)])
def test_a_program_behind_a_network_that_answers_nothing_counts_as_alive(
    connect: Connect, node: Node, monkeypatch: pytest.MonkeyPatch, error: OSError, alive: bool
) -> None:
    """The robot may still get its commands, and two programs must not command one arm."""

    def answer(*_: object) -> None:
        raise error

    with another_program():
        wait(lambda: len(node.publishers(TOPIC)) == 1, "the other program is known")
        monkeypatch.setattr(node_module.socket, "create_connection", answer)
        assert bool(node.publishers(TOPIC)) is alive
        monkeypatch.undo()
