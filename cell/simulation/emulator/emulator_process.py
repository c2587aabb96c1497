"""The process of the emulated robot: it serves the simulated cell over ROS, like a real robot.

Requests that a real robot does not have (attendant, faults, truth, checkpoints) arrive over a pipe. The process
ends when the pipe is closed.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from foldcell.cell.simulation import SimulatedCell, open_simulated_cell
from foldcell.robots.errors import CellError
from foldcell.robots.registry import find_robot
from foldcell.robots.ros.driver import EmulatedRobot

SWITCH_S = 5e-4
"""Time after which Python switches to another thread [s]. Each topic has a thread. With the default of 5 ms, two
of these threads would take a whole tick."""


PATIENCE_S = 0.3
"""Longest time for which the emulator waits for a command [s]. A command that comes later is treated as late, as
on a real robot."""


def main() -> None:
    sys.setswitchinterval(SWITCH_S)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection = Connection(int(sys.argv[1]))
    settings, seed, topics, network = connection.recv()
    with ExitStack() as closing:
        try:
            cell = closing.enter_context(open_simulated_cell(settings, seed))
            driver = find_robot(settings.robot).driver
            assert driver is not None  # checked before this process was started
            tell = partial(print, "the robot does not execute an order on", file=sys.stderr, flush=True)
            emulator = closing.enter_context(driver.emulate(cell.ports, topics, PATIENCE_S, network, tell))
        except CellError as error:
            connection.send(error)
            return
        gc.collect()
        gc.freeze()
        _serve(connection, cell, emulator)


def _serve(connection: Connection, cell: SimulatedCell, emulator: EmulatedRobot) -> None:
    ports = cell.ports
    ended = threading.Event()
    answers: Mapping[str, Callable[..., Any]] = {
        "truth": cell.truth.now,
        "inject": cell.faults.add,
        "checkpoint": cell.checkpoint.save,
        "restore": cell.checkpoint.restore,
        "lay_garment": ports.attendant.lay_garment,
        "bring_board": ports.attendant.bring_board,
    }

    def listen() -> None:
        try:
            emulator.perform(lambda: None).result()  # returns after all topics were published
            connection.send("ready")
            while True:
                name, *arguments = connection.recv()
                try:
                    connection.send(emulator.perform(partial(answers[name], *arguments)).result())
                except CellError as error:
                    connection.send(error)
        except (EOFError, OSError, CancelledError):  # the client or the emulator has ended
            pass
        finally:
            ended.set()
            connection.close()

    threading.Thread(target=listen, name="outside", daemon=True).start()
    emulator.run(ended)


if __name__ == "__main__":
    main()
