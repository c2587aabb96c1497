"""Reading a bench's figures from a file: its last line or the whole file. Other files are refused."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.figures_file import read_figures
from benchmarks.perception import document
from foldcell.robots.errors import ConfigurationError

PAGES = {
    "benchmarks.cloth.results": "bench cloth",
    "benchmarks.optimise.results": "bench optimise",
    "benchmarks.perception.document": "bench perception",
}


@pytest.fixture
def called(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Runs a module as `python -m` does, but in this process. Returns exit code, output and error output."""

    def call(module: str, *arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", [module, *arguments])
        monkeypatch.delitem(sys.modules, module, raising=False)  # it is executed anew
        with pytest.raises(SystemExit) as end:
            runpy.run_module(module, run_name="__main__")
        return end.value.code, *capsys.readouterr()  # type: ignore[return-value]

    return call


@pytest.mark.parametrize("module", PAGES)
@pytest.mark.parametrize("content", [None, b"", b"{", b"[1, 2]", b'{"other": 1}', b"\xff\xfe\x00"])
def test_a_missing_or_foreign_file_is_refused(
    module: str, content: bytes | None, tmp_path: Path, called: Callable[..., tuple[int, str, str]]
) -> None:
    file = tmp_path / "figures.json"
    if content is not None:
        file.write_bytes(content)
    code, out, err = called(module, str(file))
    assert code == 64 and out == ""
    assert str(file) in err and PAGES[module] in err and "Traceback" not in err


@pytest.mark.parametrize("module", PAGES)
def test_a_call_without_a_file_is_refused(module: str, called: Callable[..., tuple[int, str, str]]) -> None:
    code, _, err = called(module)
    assert code == 64 and f"python -m {module} figures.json" in err


@pytest.mark.long
def test_a_process_refuses_a_missing_file_without_a_traceback(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "benchmarks.cloth.results", str(tmp_path / "figures.json")]
    answer = subprocess.run(line, capture_output=True, text=True)
    assert answer.returncode == 64 and answer.stdout == ""
    assert "foldcell bench cloth" in answer.stderr and "Traceback" not in answer.stderr


def test_foreign_figures_leave_the_page_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(KeyError):
        document.write({"scenes": 1}, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", ["{}", "progress\n{}\n", None])
def test_figures_are_read_from_the_whole_file_or_its_last_line(shape: str | None, tmp_path: Path) -> None:
    figures, file = {"a_mm": 1.5, "list": [{"b": 2}]}, tmp_path / "figures.json"
    file.write_text(json.dumps(figures, indent=1) if shape is None else shape.format(json.dumps(figures)))
    assert read_figures([str(file)], "cloth", "benchmarks.cloth.results") == figures


def test_a_folder_instead_of_a_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_figures([str(tmp_path)], "cloth", "benchmarks.cloth.results")
