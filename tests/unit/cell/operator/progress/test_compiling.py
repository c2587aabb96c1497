"""Messages about compiling: once for each part with a cold cache, none with a warm one."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import numba
import pytest

from foldcell.cell.operator.progress import compiling
from foldcell.cell.operator.progress.compiling import PARTS, WAITS, report_compilation
from foldcell.skills.compiled import WAITING

USE = """
import numpy as np
from foldcell.cell.operator.progress.compiling import report_compilation
from foldcell.skills.motion.kinematics.ik import _pose_error
with report_compilation(print):
    _pose_error(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), np.zeros(6))
"""


def compiled(module: str) -> None:
    """A new function, as if it stood in `module`, used for the first time."""

    def add(x):
        return x + 1

    add.__module__ = module
    numba.njit(add)(1)


def test_each_compiled_part_is_announced_once() -> None:
    told: list[str] = []
    with report_compilation(told.append):
        for module in (
            "numpy.linalg",
            "foldcell.skills.motion.kinematics.ik",
            "foldcell.skills.cloth.kernel",
            "foldcell.skills.cloth.clusters",
        ):
            compiled(module)
    assert told == [PARTS["foldcell.skills.motion"], PARTS["foldcell.skills.cloth"]]
    compiled("foldcell.skills.cloth.kernel")
    assert len(told) == 2, "outside nothing is told"


def test_a_long_compilation_is_reported_again_and_again_until_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "STILL_EVERY", 0.02)
    told: list[str] = []
    enough = threading.Event()

    def same(x): ...

    @numba.extending.overload(same)
    def compile_same(x):
        enough.wait(10.0)  # a part of the compilation: it lasts until the second report is there
        return lambda x: x

    def say(text: str) -> None:
        told.append(text)
        if len(told) == 3:
            enough.set()

    def entry(x):
        return same(x)

    entry.__module__ = "foldcell.skills.cloth.kernel"
    with report_compilation(say):
        numba.njit(entry)(1)
    assert told[0] == PARTS["foldcell.skills.cloth"]
    assert all(text.startswith("still compiling, ") and text.endswith(" s so far") for text in told[1:])
    assert len(told) >= 3


def test_a_part_is_announced_once_also_if_another_process_compiles_it() -> None:
    told: list[str] = []
    with report_compilation(told.append):
        for module in (
            "foldcell.skills.perception.registration.energy",
            "foldcell.skills.cloth.kernel",
            "foldcell.skills.cloth.kernel",
        ):
            with numba.core.event.trigger_event(WAITING, {"module": module}):
                pass
        compiled("foldcell.skills.cloth.intersections.crossings")
    assert told == [WAITS + PARTS["foldcell.skills.cloth"]], "what is left to compile is not announced again"


def test_cached_code_is_not_announced(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    cold, warm = (
        subprocess.run(
            [sys.executable, "-c", USE], capture_output=True, text=True, check=True, env=environment
        ).stdout
        for _ in range(2)
    )
    assert cold == PARTS["foldcell.skills.motion"] + "\n" and warm == ""
