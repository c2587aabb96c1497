"""Runs of the command line for the measurement of the operator's page, with and without the page."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

from foldcell.cell.support.files.paths import journal_path

MAIN = (sys.executable, "-m", "foldcell.cell.commands.main")
QUESTIONS = ("awaiting_approval", "awaiting_pressing", "asking")
LONGEST_S = 1200.0


@contextmanager
def spinning(count: int) -> Iterator[None]:
    """Keep `count` processors busy."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


class Run:
    """A supervised run in a process of its own, which ends with the context. address: of its page."""

    def __init__(self, garment: str, seed: int, logs: Path) -> None:
        self.logs = logs
        command = [*MAIN, "supervise", garment, "--seed", str(seed), "--logs", str(logs), "--json"]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._out: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.address = self._find_address()

    def _read(self) -> None:
        assert self.process.stdout is not None
        self._out.extend(self.process.stdout)

    def _find_address(self) -> str:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            found = re.search(r"operator's page: (\S+)", line)
            if found:
                threading.Thread(target=list, args=(self.process.stderr,), daemon=True).start()
                return found[1]
        raise RuntimeError("the run ended before it served its page")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait()

    @property
    def origin(self) -> str:
        return "/".join(self.address.split("/")[:3])

    @property
    def folder(self) -> Path:
        return next(path for path in self.logs.iterdir() if path.is_dir())

    def listening(self) -> list[str]:
        """Return the addresses at which processes of the run listen; empty without the program `ss`."""
        if shutil.which("ss") is None:
            return []
        pids = {str(self.process.pid), *_children(self.process.pid)}
        lines = subprocess.run(["ss", "-ltnpH"], capture_output=True, text=True, check=True).stdout.splitlines()
        return sorted(line.split()[3] for line in lines if pids & set(re.findall(r"pid=(\d+)", line)))

    def result(self) -> dict[str, Any]:
        """Wait for the end of the run. Returns its result."""
        self.process.wait(LONGEST_S)
        self._reader.join()
        return dict(json.loads(self._out[-1]))

    def asked_s(self) -> float:
        """Return the wall time that the run waited for answers [s]."""
        return _asked_s(self.logs)


def unsupervised(garment: str, seed: int, logs: Path) -> dict[str, Any]:
    """Perform the same run without a person, at the same speed. Returns its result."""
    command = [*MAIN, "fold", garment, "--seed", str(seed), "--logs", str(logs), "--realtime", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def _children(pid: int) -> set[str]:
    try:
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return set()
    return {*listed, *(deeper for child in listed for deeper in _children(int(child)))}


def _asked_s(logs: Path) -> float:
    """The wall time between the question and the next event, from the journal."""
    with sqlite3.connect(journal_path(logs)) as journal:
        rows = journal.execute(
            "SELECT state, wall_time FROM events WHERE kind = 'event' ORDER BY run, sequence"
        ).fetchall()
    return sum(float(later[1] - now[1]) for now, later in pairwise(rows) if now[0] in QUESTIONS)
