"""The cloth simulation is compiled beside a run that finds no compiled code, and only then."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from foldcell.cell.runs import compiling_ahead as ahead
from foldcell.skills.cloth import compile_loop, kernel


def test_compiled_code_starts_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "is_compiled", lambda: True)
    monkeypatch.setattr(subprocess, "Popen", None)
    with ahead.compiling_ahead():
        pass


def test_the_process_works_within_the_context_and_ends_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process of this test says that it works and would then go on for ever."""
    folder = tmp_path / "foldcell" / "skills" / "cloth"
    folder.mkdir(parents=True)
    (tmp_path / "foldcell" / "__init__.py").touch()
    works = tmp_path / "works"
    text = f"import pathlib, time\npathlib.Path({str(works)!r}).touch()\ntime.sleep(1e6)\n"
    (folder / "compile_loop.py").write_text(text)
    monkeypatch.setattr(ahead, "is_compiled", lambda: False)
    monkeypatch.setattr(ahead, "program_environment", lambda: {"PYTHONPATH": str(tmp_path)})
    begun: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def begin(*about: object, **options: object) -> subprocess.Popen[bytes]:
        begun.append(popen(*about, **options))  # type: ignore[call-overload]
        return begun[0]

    monkeypatch.setattr(subprocess, "Popen", begin)
    monkeypatch.chdir(tmp_path)
    with ahead.compiling_ahead():
        while not works.exists():
            assert begun[0].poll() is None
    assert begun[0].poll() is not None


def test_the_process_compiles_with_the_types_of_a_run() -> None:
    """All cloth has the same types, so the code of a small one serves a run: one entry, which was there before."""
    loop: Any = kernel.run_frames
    before = loop._cache.check() if compile_loop.is_compiled() else 1
    compile_loop.main()
    assert compile_loop.is_compiled() and loop._cache.check() == before == len(loop.signatures)
