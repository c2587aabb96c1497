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
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from cell import simulation
from robots.baxter.emulator.emulator import Emulator
from robots.baxter.ros.node import open_node
from robots.baxter.ros.topics import CameraTopics
from robots.errors import CellError
from robots.ports import Ports

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
    try:
        ports = simulation.open_cell(settings, seed)
    except CellError as error:
        connection.send(error)
        return
    gc.collect()
    gc.freeze()
    try:
        _serve(connection, ports, topics)
    finally:
        simulation.close_cell(ports)


def _serve(connection: Connection, ports: Ports, topics: CameraTopics) -> None:
    node = open_node("baxter_emulator")
    emulator = Emulator(ports, node, topics, patience=PATIENCE_S)
    over = threading.Event()
    answers: Mapping[str, Callable[..., Any]] = {
        "truth": lambda: simulation.truth(ports),
        "inject": lambda fault: simulation.inject(ports, fault),
        "checkpoint": lambda: simulation.checkpoint(ports),
        "restore": lambda saved: simulation.restore(ports, saved),
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
