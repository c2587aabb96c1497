"""The simulated cell in a process of its own, behind ROS as a real robot is.

What is no robot's (the attendant, faults, the truth, checkpoints) comes over a pipe. The process ends with it.
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

from cell.simulation import SimulatedCell, open_simulated_cell
from robots.baxter.emulator.emulator import Emulator
from robots.baxter.ros.node import open_node
from robots.baxter.ros.topics import CameraTopics
from robots.errors import CellError

__all__ = ["main"]


SWITCH_S = 5e-4
"""Each topic has a thread of its own: with Python's 5 ms their turns take longer than a tick."""


PATIENCE_S = 0.3
"""Beyond this the executive is late, as it would be with a robot."""


def main() -> None:
    sys.setswitchinterval(SWITCH_S)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection = Connection(int(sys.argv[1]))
    settings, seed, topics = connection.recv()
    with ExitStack() as closing:
        try:
            cell = closing.enter_context(open_simulated_cell(settings, seed))
        except CellError as error:
            connection.send(error)
            return
        gc.collect()
        gc.freeze()
        _serve(connection, cell, topics)


def _serve(connection: Connection, cell: SimulatedCell, topics: CameraTopics) -> None:
    ports = cell.ports
    node = open_node("baxter_emulator")
    emulator = Emulator(ports, node, topics, patience=PATIENCE_S)
    over = threading.Event()
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
            emulator.perform(lambda: None).result()  # everything was published by then
            connection.send("ready")
            while True:
                name, *given = connection.recv()
                try:
                    connection.send(emulator.perform(partial(answers[name], *given)).result())
                except CellError as error:
                    connection.send(error)
        except (EOFError, OSError, CancelledError):  # whoever asks is gone, or the emulator is
            pass
        finally:
            over.set()
            connection.close()

    threading.Thread(target=listen, name="outside", daemon=True).start()
    try:
        emulator.run(over)
    finally:
        node.close()


if __name__ == "__main__":
    main()
