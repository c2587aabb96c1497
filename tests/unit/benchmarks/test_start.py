"""The timer of installing, compiling and starting measures what it says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import start
from benchmarks.start import ROOT, Part, main, measure

NOTE = """
import os, sys
from pathlib import Path
with open(sys.argv[1], "a") as f:
    print(Path.cwd(), os.environ["PYTHONPATH"], *sorted(p.name for p in Path.cwd().rglob("__pycache__")), file=f)
"""


def noted(folder: Path, fresh: bool) -> list[list[str]]:
    """What each process of a part sees, measured twice: its folder, PYTHONPATH and folders of compiled modules."""
    timings = measure(Part("", (sys.executable, "-c", NOTE, str(folder / "notes")), fresh), times=2)
    assert len(timings) == 2
    return [line.split() for line in (folder / "notes").read_text().splitlines()]


def test_what_begins_anew_begins_in_another_clone_with_nothing_compiled(tmp_path: Path) -> None:
    first, second = noted(tmp_path, fresh=True)
    for cwd, *rest in (first, second):
        assert rest == [cwd] and Path(cwd) != ROOT
        assert not Path(cwd).exists()
    assert first != second


def test_what_is_warm_was_performed_before_in_this_checkout(tmp_path: Path) -> None:
    seen = noted(tmp_path, fresh=False)
    assert [line[:2] for line in seen] == 3 * [[str(ROOT), str(ROOT)]]


def test_times_are_those_of_the_process() -> None:
    busy = "import time; end = time.process_time() + 0.2\nwhile time.process_time() < end: pass"
    (timing,) = measure(Part("", (sys.executable, "-c", busy)), times=1)
    assert timing.cpu_s >= 0.2 and timing.wall_s >= 0.2


def test_a_part_that_fails_has_no_time() -> None:
    with pytest.raises(subprocess.CalledProcessError):
        measure(Part("", (sys.executable, "-c", "raise SystemExit(3)")), times=1)


def test_the_named_parts_are_printed_as_a_section(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", "import", "--times", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" | ")[:2] for line in lines if "`" in line] == [
        ["| help", "`foldcell --help`"],
        ["| import", "`import foldcell`"],
    ]


def test_an_unknown_part_is_refused_before_anything_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start, "measure", lambda *_: pytest.fail("measured"))
    with pytest.raises(SystemExit):
        main(["help", "instaling"])
