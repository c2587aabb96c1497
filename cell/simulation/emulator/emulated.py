"""The emulated robot: the simulated world behind ROS, used through the driver of the real robot.

The world runs in another process. Its time advances whether or not commands arrive, but never faster than the wall
clock.
"""

from __future__ import annotations

import atexit
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any

from foldcell.cell.simulation.faults import Fault
from foldcell.cell.simulation.port_worlds import bind, unbind, world_behind
from foldcell.cell.simulation.server_process import ServerProcess, program_environment
from foldcell.cell.simulation.settings import SimulationSettings
from foldcell.cell.simulation.simulated_cell import Checkpoint, Display, SimulatedCell, TruthSource
from foldcell.robots.errors import ConfigurationError, DriverError, FailureKind
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import BoardPlace, CameraFrame
from foldcell.robots.ros.driver import Network, RosDriver, RosSettings

START_S = 60.0
ANSWER_S = 120.0
"""Longest wall time to wait for one answer [s]. Laying a garment takes longest, because the cloth must come to
rest."""

_master: subprocess.Popen[bytes] | None = None
_starting = threading.Lock()


@contextmanager
def emulated_cell(
    settings: SimulationSettings,
    seed: int,
    robot: RosDriver,
    ros: RosSettings,
    network: Network,
    limits: JointLimits,
) -> Iterator[SimulatedCell]:
    """Open a simulated cell whose ports are those of the driver `robot`. network: how its messages travel. limits:
    the driver clips set-points to them.

    Raises ConfigurationError if ROS is missing, and the errors of `open_simulated_cell`.
    """
    _start_master()
    with ExitStack() as closing:
        world = _World(settings, seed, ros, network)
        closing.callback(world.close)
        attendant = _Attendant()
        bind([attendant], world)
        closing.callback(unbind, world)
        ports = closing.enter_context(
            robot.connect(ros, limits, lambda _: attendant, driver="emulator", simulated=True)
        )
        closing.enter_context(_silent_master(network.master_silent_from, network.master_silent_for))

        def display() -> Callable[[], CameraFrame | None]:
            frame = ports.camera.glimpse()
            return lambda: frame

        yield SimulatedCell(
            ports,
            TruthSource(partial(world.ask, "truth"), lambda tell: None),
            world,
            Checkpoint(partial(world.ask, "checkpoint"), partial(world.ask, "restore")),
            Display(display, lambda: None, lambda tell: None),
        )


class _Attendant:
    def lay_garment(self) -> None:
        world_behind(self).ask("lay_garment")

    def bring_board(self, place: BoardPlace) -> None:
        world_behind(self).ask("bring_board", place)


class _World:
    """Access to the parts of the world that the executive does not see, over a pipe to its process."""

    def __init__(self, settings: SimulationSettings, seed: int, ros: RosSettings, network: Network) -> None:
        self._process = ServerProcess("foldcell.cell.simulation.emulator.emulator_process", silent=False)
        self._asking = threading.Lock()
        self._why_gone = "its process ended"
        try:
            self._process.send((settings, seed, ros.camera, network))
            self._answer(START_S)
        except BaseException:
            self.close()
            raise

    def ask(self, name: str, *arguments: Any) -> Any:
        """Return the answer of the world's process. Raises the exceptions that were raised in that process, and
        DriverError(HARDWARE_FAULT) if it has ended."""
        with self._asking:
            with suppress(OSError):  # the answer says what is wrong
                self._process.send((name, *arguments))
            return self._answer(ANSWER_S)

    def add(self, fault: Fault) -> None:
        self.ask("inject", fault)

    def close(self) -> None:
        self._process.close(patience_s=3.0)

    def _answer(self, seconds: float) -> Any:
        try:
            answer = self._process.answer(seconds)
        except TimeoutError as error:
            self._why_gone = str(error)  # the pipe is closed from now on, although the process has not ended
            raise _gone(self._why_gone) from None
        except (EOFError, OSError) as error:
            raise _gone(self._why_gone) from error
        if isinstance(answer, Exception):
            raise answer
        return answer


def _gone(why: str) -> DriverError:
    return DriverError(
        FailureKind.HARDWARE_FAULT,
        f"the emulated robot does not respond: {why}",
        "start the run again; see its output",
    )


@contextmanager
def _silent_master(begin: float, seconds: float) -> Iterator[None]:
    """Suspend the master `begin` seconds from now, for `seconds`, at most until the context ends."""
    assert _master is not None
    timers = [
        threading.Timer(after, _master.send_signal, (number,))
        for after, number in ((begin, signal.SIGSTOP), (begin + seconds, signal.SIGCONT))
    ]
    for timer in timers if seconds else ():
        timer.daemon = True
        timer.start()
    try:
        yield
    finally:
        for timer in timers:
            timer.cancel()
        _master.send_signal(signal.SIGCONT)


def _start_master() -> None:
    """Start one ROS master for the life of this process, because rospy allows only one master per process."""
    global _master
    with _starting:
        if _master is not None and _master.poll() is None:
            return
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
        os.environ.pop("ROS_HOSTNAME", None)
        _master = subprocess.Popen(
            [sys.executable, "-m", "foldcell.cell.simulation.emulator.ros_master", str(port)],
            env=program_environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        assert _master.stdout is not None
        if _master.stdout.readline().strip() != b"ready":
            _master = None
            raise ConfigurationError("the ROS master does not start", "`foldcell doctor` shows what is missing")
        atexit.register(_master.kill)
