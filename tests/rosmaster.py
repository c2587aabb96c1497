"""A ROS master for the test session. A process can be a node of only one master, so all tests share it."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

import pytest

from tests.optional_parts import ROS, ROS_PATH

BEGIN_S = 30.0


@pytest.fixture(scope="session")
def rosmaster() -> Iterator[str]:
    """The URI of a running master. This process's environment names it."""
    ROS.require()
    program = shutil.which("rosmaster", path=ROS_PATH)
    assert program is not None
    port = free_port()
    with tempfile.TemporaryDirectory(prefix="foldcell-ros-") as logs, pytest.MonkeyPatch.context() as patch:
        uri = f"http://127.0.0.1:{port}"
        patch.setenv("ROS_MASTER_URI", uri)
        patch.setenv("ROS_IP", "127.0.0.1")
        patch.setenv("ROS_LOG_DIR", logs)
        patch.delenv("ROS_HOSTNAME", raising=False)
        master = subprocess.Popen(
            [program, "--core", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            wait_for_master(master, port)
            yield uri
            if "rospy" in sys.modules:  # while the master still runs
                sys.modules["rospy"].signal_shutdown("the tests are over")
        finally:
            master.kill()
            master.wait()


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def wait_for_master(master: subprocess.Popen, port: int) -> None:
    until = time.monotonic() + BEGIN_S
    while time.monotonic() < until:
        assert master.poll() is None, f"rosmaster ended with {master.returncode}"
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            return
        except OSError:
            time.sleep(0.05)
    raise AssertionError(f"rosmaster did not answer within {BEGIN_S:.0f} s")
