"""A process of this program that answers messages over a pipe."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

ROOT = Path(__file__).absolute().parents[3]
"""The folder that contains the package `foldcell`."""


class ServerProcess:
    """Runs `python -m MODULE FD`, where FD is the descriptor of its end of the pipe. Ctrl-C does not reach it. It
    has to end when the pipe is closed. silent: whether its errors are not shown."""

    def __init__(self, module: str, silent: bool) -> None:
        self._connection, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, str(theirs.fileno())], pass_fds=[theirs.fileno()],
            env=program_environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL if silent else None, start_new_session=True,
        )  # fmt: skip
        theirs.close()

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, message: Any) -> None:
        """Send a message without waiting for an answer. Raises OSError."""
        self._connection.send(message)

    def answer(self, timeout_s: float) -> Any:
        """Return the next answer. Raises OSError or EOFError if the process has ended, TimeoutError if it does not
        answer in time. A late answer would be taken for the next one, so the pipe is then closed."""
        if not self._connection.poll(timeout_s):
            self._connection.close()
            raise TimeoutError(f"no answer in {timeout_s:.0f} s")
        return self._connection.recv()

    def close(self, patience_s: float) -> None:
        """Close the pipe, and kill the process if it has not ended after `patience_s` [s]."""
        self._connection.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience_s)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def program_environment() -> Mapping[str, str]:
    """Return the environment in which Python finds this program."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
