"""Perform a random case in a process of its own, and judge how it ended.

The process is a fork of one that has loaded the program, so that a case takes a few milliseconds. It opens no
cell: where a run would open it, the case ends with a refusal. A command that is still at work after `patience` is
ended by SIGINT, as by Ctrl-C.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, NoReturn

import cv2
import yaml

from benchmarks.inputs.cases import Case
from benchmarks.inputs.samples import KINDS
from foldcell.robots.errors import ConfigurationError

LONGEST_S = 60.0
"""A case that takes longer hangs [s]."""
MOST_MEMORY = 2.0
"""A case whose process needs more takes too much [GiB]. The loaded program is a quarter of it."""
CODES = {0, 2, 3, 64, 130}
"""The documented exit codes; those of other signals cannot occur."""


def perform(case: Case, samples: Path, patience: float) -> list[str]:
    """Perform a case in a copy of the samples. Returns what is wrong with its end, in words; empty if nothing is.
    patience: time after which a command that still works is ended by SIGINT [s]."""
    with tempfile.TemporaryDirectory(prefix="foldcell-case-") as name:
        folder = Path(name) / "cell"
        shutil.copytree(samples, folder, symlinks=True)
        for inner in ("home", "tmp"):
            (folder / inner).mkdir()
        for damage in case.damages:
            file = folder / KINDS[damage.kind]
            file.write_bytes(damage(file.read_bytes()))
        before = dict(_contents(folder))
        child = os.fork()
        if child == 0:
            _child(case, folder, Path(name))
        code, hangs, memory = _waited(child, patience)
        streams = [
            (Path(name) / stream).read_text(encoding="utf-8", errors="replace") for stream in ("out", "err")
        ]
        wrong = [f"still at work after {LONGEST_S:.0f} s"] if hangs else _wrong_end(case, code, *streams)
        if memory > MOST_MEMORY:
            wrong.append(f"took {memory:.1f} GiB of memory")
        return wrong + _wrong_files(case, code, folder, before)


def _waited(child: int, patience: float) -> tuple[int, bool, float]:
    """Wait for the end of the process. Returns its exit code (negative: the signal that killed it), whether it had
    to be killed, and the largest memory that it and its own processes took [GiB]."""
    began, told = time.monotonic(), False
    while True:
        ended, status, used = os.wait4(child, os.WNOHANG)
        if ended:
            with suppress(ProcessLookupError):  # processes that it has left behind
                os.killpg(child, signal.SIGKILL)
            return os.waitstatus_to_exitcode(status), False, used.ru_maxrss / 2**20
        spent = time.monotonic() - began
        if spent > patience and not told:
            told = True
            os.kill(child, signal.SIGINT)
        if spent > LONGEST_S + patience:
            os.killpg(child, signal.SIGKILL)
            used = os.wait4(child, 0)[2]
            return -signal.SIGKILL, True, used.ru_maxrss / 2**20
        time.sleep(0.002 if spent < 0.5 else 0.02)


def _child(case: Case, folder: Path, outside: Path) -> NoReturn:
    """Perform the case and end the process."""
    code = 97
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.chdir(folder)
        for name, value in {**dict(case.environment), "TMPDIR": str(folder / "tmp")}.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        tempfile.tempdir = None
        _redirect(case, outside)
        sys.argv = ["foldcell", *case.words]
        _open_no_cell()
        from foldcell.cell.commands.main import main

        code = main(list(case.words))
        with suppress(OSError, ValueError, AttributeError):  # it is closed
            sys.stdout.flush()
    except SystemExit as e:
        code = e.code if isinstance(e.code, int) else 98
    except BaseException:
        import traceback

        (outside / "err").open("a").write("Traceback that left main\n" + traceback.format_exc())
    finally:
        os._exit(code)


def _redirect(case: Case, outside: Path) -> None:
    """Set the three standard streams of the process."""
    (outside / "out").touch()
    (outside / "letters").write_text("a\nx\n\n", encoding="utf-8")
    reading, writing = os.pipe()
    os.close(reading)
    outputs = {"file": outside / "out", "closed": outside / "out", "full": "/dev/full"}
    out = writing if case.stdout == "pipe" else os.open(outputs[case.stdout], os.O_WRONLY)
    os.dup2(os.open("/dev/null" if case.stdin != "letters" else outside / "letters", os.O_RDONLY), 0)
    os.dup2(out, 1)
    os.dup2(os.open(outside / "err", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
    sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w")
    if case.stdin == "closed":
        os.close(0)
        sys.stdin = None
    if case.stdout == "closed":
        os.close(1)
        sys.stdout = None


def _open_no_cell() -> None:
    import foldcell.cell.calibrating.session
    import foldcell.cell.campaigns.executors
    import foldcell.cell.commands.run.reset
    import foldcell.cell.hardware.driver
    import foldcell.cell.runs.fold_run

    def refuse(*_: Any) -> NoReturn:
        raise ConfigurationError("a random case opens no cell", "")

    modules: tuple[Any, ...] = (foldcell.cell.calibrating.session, foldcell.cell.runs.fold_run)
    for module in modules:
        module.opened_cell = refuse
    foldcell.cell.hardware.driver.stop_circuit = refuse
    foldcell.cell.campaigns.executors.worker_pool = refuse


def _wrong_end(case: Case, code: int, out: str, err: str) -> list[str]:
    wrong = []
    if code not in CODES:
        wrong.append(f"exit code {code}")
    if "Traceback" in out + err or "bug in foldcell" in out + err:
        wrong.append("a traceback: " + err[-1500:])
    if code == 64 and not err.strip():
        wrong.append("refused without a word")
    if case.stdout == "file" and "--json" in case.words and "--" not in case.words and code != 130:
        try:
            last = json.loads(out.rstrip("\n").split("\n")[-1])
            assert isinstance(last, dict)
        except (ValueError, AssertionError):
            if "-h" not in case.words and "--help" not in case.words:
                wrong.append(f"the last line is no JSON object (exit code {code}): {out[-300:]!r}")
    return wrong


def _wrong_files(case: Case, code: int, folder: Path, before: dict[str, str]) -> list[str]:
    after = dict(_contents(folder))
    wrong = []
    for name in sorted(after.keys() - before.keys()):
        if "crash-" in name:
            wrong.append(f"a crash file: {(folder / name).read_text()[-1500:]}")
        elif not _whole(folder / name):
            wrong.append(f"{name} is half-written")
        elif code == 64 and case.stdout == "file" and not name.startswith(_own_folders(case)):
            wrong.append(f"refused, but {name} was written")
    gone = [
        name for name, content in before.items() if after.get(name) != content and not name.startswith("logs/")
    ]
    if gone and "--replace" not in case.words and "tidy" not in case.words:
        wrong.append(f"changed: {', '.join(gone)}")
    return wrong


def _own_folders(case: Case) -> tuple[str, ...]:
    """Return the folders in which a run that is refused may leave its journal, and the cache."""
    named = [os.path.normpath(case.words[k + 1]) for k, word in enumerate(case.words[:-1]) if word == "--logs"]
    return ("logs", "new logs", "home", "tmp", "relative", *named)


def _contents(folder: Path) -> Iterator[tuple[str, str]]:
    for root, _, names in os.walk(folder):
        for name in names:
            file = Path(root) / name
            if file.is_file() and not file.is_symlink():
                yield str(file.relative_to(folder)), sha256(file.read_bytes()).hexdigest()


def _whole(file: Path) -> bool:
    """Whether a file that a command has written is complete."""
    if file.name.startswith(".") and file.name != ".owner":
        return False
    try:
        if file.suffix == ".json":
            json.loads(file.read_bytes())
        elif file.suffix in (".yaml", ".yml"):
            yaml.safe_load(file.read_bytes())
        elif file.suffix in (".png", ".jpg"):
            return cv2.imread(str(file)) is not None
        elif file.suffix == ".db":
            with sqlite3.connect(file) as journal:
                return bool(journal.execute("pragma quick_check").fetchone() == ("ok",))
    except (ValueError, yaml.YAMLError, sqlite3.Error):
        return False
    return True
