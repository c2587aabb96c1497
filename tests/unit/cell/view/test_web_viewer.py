"""The program files of Rerun's web viewer are taken from the installed package, once."""

from __future__ import annotations

from pathlib import Path

import pytest

from foldcell.cell.view import viewer as web_viewer
from foldcell.cell.view.viewer import FILES, silent_environment, web_viewer_files
from foldcell.robots.errors import StorageError


def test_the_files_are_unpacked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = web_viewer_files(tmp_path)
    script, program = ((folder / name).read_bytes() for name in FILES)
    assert program.startswith(b"\0asm") and b"class WebHandle" in script
    assert [path.name for path in tmp_path.iterdir()] == [folder.name], "nothing else is left"
    monkeypatch.setattr(web_viewer, "_from_program", lambda *_: 1 / 0)
    assert web_viewer_files(tmp_path) == folder


def test_a_missing_program_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_viewer, "find_viewer", lambda: None)
    with pytest.raises(StorageError, match="not installed"):
        web_viewer_files(tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_viewer_takes_itself_for_a_test() -> None:
    assert silent_environment()["CI"] == "1"
