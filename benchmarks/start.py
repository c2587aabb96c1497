"""Times how foldcell is installed and compiled, and how soon its commands answer.

    python -m benchmarks.start [PART ...] [--times 3]

Each part is a process of its own, measured several times. Without a name all parts are measured, which takes a
quarter of an hour. `installing` and `compiling` begin anew each time, in a fresh clone of this checkout's last
commit. The other parts are performed once before, so that nothing is compiled and all files are in memory. Run it
on an idle machine: the load beside each figure says whether it was.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.results_page import table
from foldcell.cell.campaigns.trials.store import commit, cpu_model

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Part:
    """A command that is timed. fresh: it begins in a fresh clone, with nothing compiled and no package
    downloaded."""

    shown: str
    command: tuple[str, ...]
    fresh: bool = False


def _foldcell(line: str, fresh: bool = False) -> Part:
    return Part(f"foldcell {line}", (sys.executable, "-m", "foldcell.cell.commands.main", *line.split()), fresh)


PARTS: Mapping[str, Part] = {
    "installing": Part("make setup", ("make", "setup"), fresh=True),
    "compiling": _foldcell("optimise small_towel", fresh=True),
    "run": _foldcell("fold medium_towel"),
    "doctor": _foldcell("doctor"),
    "garment-list": _foldcell("garment list"),
    "runs": _foldcell("runs"),
    "fold-help": replace(_foldcell("fold --help"), shown="help of fold"),
    "help": _foldcell("--help"),
    "import": Part("import foldcell", (sys.executable, "-c", "import foldcell")),
}


@dataclass(frozen=True)
class Timing:
    """One measurement: wall and CPU time [s] of the process with its children, and the machine's load (mean of the
    minute before it)."""

    wall_s: float
    cpu_s: float
    load: float


def measure(part: Part, times: int) -> list[Timing]:
    """Perform a part `times` times. Raises CalledProcessError if it fails."""
    if not part.fresh:
        _timed(part)
    return [_timed(part) for _ in range(times)]


def _timed(part: Part) -> Timing:
    with tempfile.TemporaryDirectory(prefix="foldcell-start-") as name:
        folder, root = Path(name), ROOT
        environment = {**os.environ, "FOLDCELL_LOGS": str(folder / "logs")}
        if part.fresh:
            root = folder / "clone"
            subprocess.run(["git", "clone", "--quiet", str(ROOT), str(root)], check=True)
            environment.pop("NUMBA_CACHE_DIR", None)
            environment |= {"UV_CACHE_DIR": str(folder / "uv"), "PIP_CACHE_DIR": str(folder / "pip")}
        environment["PYTHONPATH"] = str(root)
        load, before, began = os.getloadavg()[0], _cpu_of_children(), time.perf_counter()
        subprocess.run(part.command, cwd=root, env=environment, stdout=subprocess.DEVNULL, check=True)
        return Timing(time.perf_counter() - began, _cpu_of_children() - before, load)


def _cpu_of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _row(name: str, timings: Sequence[Timing]) -> tuple[str, ...]:
    walls = [t.wall_s for t in timings]
    loads = [t.load for t in timings]
    return (
        name, f"`{PARTS[name].shown}`", f"{statistics.median(walls):.2f}", f"{min(walls):.2f} to {max(walls):.2f}",
        f"{statistics.median(t.cpu_s for t in timings):.2f}", f"{min(loads):.1f} to {max(loads):.1f}",
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the named parts and print a section of docs/results/time.md."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.start", description="Time how foldcell starts.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)} (all)")
    parser.add_argument("--times", type=int, default=3, help="measurements of each part (3)")
    options = parser.parse_args(arguments)
    if unknown := sorted(set(options.parts) - PARTS.keys()):
        parser.error(f"there is no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    rows = []
    for name in options.parts or PARTS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows.append(_row(name, measure(PARTS[name], options.times)))
    cores, load = len(os.sched_getaffinity(0)), ", ".join(f"{v:.1f}" for v in os.getloadavg())
    title = f"{time.strftime('%Y-%m-%d', time.gmtime())}, commit {commit() or 'unknown'}"
    print(table(title, ("part", "command", "median [s]", "range [s]", "CPU [s]", "load"), rows))
    print(f"\n{cpu_model()}, {cores} cores; load at the end (1, 5 and 15 minutes): {load}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
