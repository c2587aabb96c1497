"""Reading a bench's figures from a file: its last line or the whole file. Other files are refused."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.figures_file import read_figures
from benchmarks.perception import document
from robots.errors import ConfigurationError

PAGES = {
    "benchmarks.cloth.results": "bench cloth",
    "benchmarks.optimise.results": "bench optimise",
    "benchmarks.perception.document": "bench perception",
}


@pytest.mark.parametrize("module", PAGES)
@pytest.mark.parametrize("content", [None, b"", b"{", b"[1, 2]", b'{"other": 1}', b"\xff\xfe\x00"])
def test_a_missing_or_foreign_file_is_refused(module: str, content: bytes | None, tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    if content is not None:
        file.write_bytes(content)
    answer = subprocess.run([sys.executable, "-m", module, str(file)], capture_output=True, text=True)
    assert answer.returncode == 64 and answer.stdout == ""
    assert str(file) in answer.stderr and PAGES[module] in answer.stderr and "Traceback" not in answer.stderr


def test_a_call_without_a_file_is_refused() -> None:
    for module in PAGES:
        answer = subprocess.run([sys.executable, "-m", module], capture_output=True, text=True)
        assert answer.returncode == 64 and f"python -m {module} figures.json" in answer.stderr


def test_foreign_figures_leave_the_page_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(KeyError):
        document.write({"scenes": 1}, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", ["{}", "progress\n{}\n", None])
def test_figures_are_read_from_the_whole_file_or_its_last_line(shape: str | None, tmp_path: Path) -> None:
    figures, file = {"a_mm": 1.5, "list": [{"b": 2}]}, tmp_path / "figures.json"
    file.write_text(json.dumps(figures, indent=1) if shape is None else shape.format(json.dumps(figures)))
    assert read_figures(file, "cloth") == figures


def test_a_folder_instead_of_a_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_figures(tmp_path, "cloth")
