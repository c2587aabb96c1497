"""Checks the shipped drivers against the contract of the ports, and writes docs/results/drivers.md.

python -m benchmarks.driver_contract
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.results_page import table
from foldcell.cell.hardware.contract.clauses import CLAUSES
from tests.broken_drivers import BROKEN

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "drivers.md"
DRIVERS = (("baxter", "sim"), ("baxter", "emulator"), ("ur5_pair", "sim"))
INTRODUCTION = """# Results: drivers and clauses

Each clause of the contract of the ports (`robots/ports.py`), and the drivers that keep it, by
`foldcell robot check NAME --driver DRIVER`. Simulated: no driver was checked at a robot. The emulator's driver is
the one for the robot, over ROS, in real time.

The broken drivers (`tests/broken_drivers.py`) break one thing each. A test checks that each fails at its clause
and at no other, and that nothing moves after the failure of a clause on which safety depends. Another test checks
a driver that cannot be opened twice (reconnect).
"""


def page(results: Mapping[str, Sequence[Mapping[str, Any]]], origin: str) -> str:
    """Write the page as Markdown. results: driver -> its clauses, as in `--json`."""
    rows = []
    for k, clause in enumerate(CLAUSES):
        verdicts = [results[driver][k] for driver in results]
        words = [v["state"].replace("_", " ") + (f": {v['reason']}" if v["reason"] else "") for v in verdicts]
        broken = "; ".join(name for name, (_, of) in BROKEN.items() if of == clause.name)
        rows.append((clause.name, clause.proves, clause.moves or "nothing", broken, *words))
    head = ("clause", "proves", "moves", "broken drivers that fail here alone", *results)
    return "\n".join([INTRODUCTION, origin, "", table("Clauses", head, rows), ""])


def main() -> None:
    results: dict[str, Sequence[Mapping[str, Any]]] = {}
    for robot, driver in DRIVERS:
        command = [
            sys.executable,
            "-m",
            "foldcell.cell.commands.main",
            "robot",
            "check",
            robot,
            "--driver",
            driver,
            "--json",
        ]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        results[f"{robot}, {driver}"] = json.loads(done.stdout.splitlines()[-1])["clauses"]
    origin = f"- {time.strftime('%Y-%m-%d')}, by the commit that last changed this page, two x86-64 cores."
    PAGE.write_text(page(results, origin), encoding="utf-8")


if __name__ == "__main__":
    main()
