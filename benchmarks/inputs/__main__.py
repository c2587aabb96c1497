"""Call all commands with random names, numbers, files and surroundings, and judge how each call ended:

    python -m benchmarks.inputs [--cases 2000] [--seed 0] [--patience 2.0] [--workers 2]

A case is good if the exit code is a documented one, no traceback reaches the user, nothing hangs longer than 60 s
or takes more than 2 GiB of memory, no file of the user is changed and none is half-written. Prints each bad case,
and a line with the counts. The exit code is 2 if there is a bad case. No robot moves and no run is simulated:
cases end where a run would open the cell.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import pkgutil
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from benchmarks.inputs.cases import LEAVES, Case, cases
from benchmarks.inputs.perform import perform
from benchmarks.inputs.samples import make_samples
from foldcell import cell

EACH = 5
"""Number of cases that are drawn at a time. Hypothesis varies earlier cases after some."""


def drawn(number: int, first: int, run: str) -> list[Case]:
    """Draw at least so many different cases, equally many of each command. first: seed."""
    found: dict[Case, None] = {}
    for leaf in itertools.cycle(range(len(LEAVES))):
        if len(found) >= number:
            return list(found)
        found |= dict.fromkeys(drawn_of(leaf, first + len(found), run))
    raise AssertionError


def drawn_of(leaf: int, first: int, run: str) -> list[Case]:
    """Draw EACH cases of one command."""
    found: list[Case] = []

    @seed(first)
    @settings(
        max_examples=EACH, phases=[Phase.generate], deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(cases(run, leaf))
    def draw(case: Case) -> None:
        found.append(case)

    draw()
    return found


def load_program() -> None:
    """Import every module of the program, so that the cases do not."""
    for module in pkgutil.walk_packages(cell.__path__, "foldcell.cell."):
        if not module.name.endswith("__main__"):
            with suppress(ModuleNotFoundError):  # of an optional part
                importlib.import_module(module.name)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--patience", type=float, default=2.0, help="seconds until Ctrl-C")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    began = time.monotonic()
    load_program()
    with tempfile.TemporaryDirectory(prefix="foldcell-samples-") as name:
        samples = Path(name) / "samples"
        all_cases = drawn(options.cases, options.seed, make_samples(samples))
        with ProcessPoolExecutor(options.workers, mp_context=get_context("fork")) as pool:
            ends = list(
                pool.map(partial(perform, samples=samples, patience=options.patience), all_cases, chunksize=4)
            )
    bad = [(case, wrong) for case, wrong in zip(all_cases, ends, strict=True) if wrong]
    for case, wrong in bad:
        print(f"foldcell {' '.join(map(ascii, case.words))}\n  {case}\n  " + "\n  ".join(wrong))
    commands = Counter(case.words[0] for case in all_cases)
    print(f"{len(all_cases)} cases of {len(commands)} commands, {len(bad)} bad, {time.monotonic() - began:.0f} s")
    return 2 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
