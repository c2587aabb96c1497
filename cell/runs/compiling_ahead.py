"""Compiles the cloth simulation in a process beside this one while the program prepares a run."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from foldcell.cell.simulation.server_process import program_environment
from foldcell.skills.cloth.compile_loop import is_compiled


@contextmanager
def compiling_ahead() -> Iterator[None]:
    """Compile it, if it was never compiled, from now on until the end of the context. Whoever needs the code waits
    for the process that compiles it (`foldcell.skills.compiled`), and compiles it if that process has failed."""
    if is_compiled():
        yield
        return
    command = [sys.executable, "-m", "foldcell.skills.cloth.compile_loop"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        command, env=program_environment(), stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    ) as process:
        try:
            yield
        finally:
            process.kill()
