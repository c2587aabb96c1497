"""Measures the time to write one line of the journal, and compares it with two peers.

One peer writes the same lines to a text file and syncs it. The other one writes them to a database without
syncing, which may lose the last lines when the machine fails.
"""

from __future__ import annotations

import json
import os
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from foldcell.cell.journal.journal import Journal

PAYLOAD = {"step": 1, "attempt": 0, "event": "done", "figures": [0.123456789] * 12}


def measure(tell: Callable[[str], None], lines: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        took = {
            "journal": _timed(_journal(Path(folder) / "journal.db"), lines),
            "synced_text_file": _timed(_text_file(Path(folder) / "lines.json"), lines),
            "unsynced_database": _timed(_unsynced(Path(folder) / "unsynced.db"), lines),
        }
    figures: dict[str, Any] = {"journal_lines": lines}
    for name, seconds in took.items():
        figures[f"{name}_line_ms_median"] = 1e3 * float(np.median(seconds))
        figures[f"{name}_line_ms_p99"] = 1e3 * float(np.quantile(seconds, 0.99))
    figures["journal_over_text_file"] = float(np.median(took["journal"]) / np.median(took["synced_text_file"]))
    tell(f"a line of the journal: {figures['journal_line_ms_median']:.2f} ms")
    return figures


def _timed(append: Callable[[int], object], lines: int) -> list[float]:
    took = []
    for n in range(lines):
        began = time.perf_counter()
        append(n)
        took.append(time.perf_counter() - began)
    return took


def _journal(path: Path) -> Callable[[int], object]:
    run = Journal.open(path).begin_run(garment="towel", seed=1, driver="sim")
    return lambda n: run.event(0.01 * n, "folding", "done", PAYLOAD)


def _text_file(path: Path) -> Callable[[int], object]:
    file = path.open("w")

    def append(n: int) -> None:
        file.write(json.dumps({"t": 0.01 * n, **PAYLOAD}) + "\n")
        file.flush()
        os.fsync(file.fileno())

    return append


def _unsynced(path: Path) -> Callable[[int], object]:
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=OFF")
    connection.execute("CREATE TABLE lines (t REAL, payload TEXT)")
    return lambda n: connection.execute("INSERT INTO lines VALUES (?, ?)", (0.01 * n, json.dumps(PAYLOAD)))
