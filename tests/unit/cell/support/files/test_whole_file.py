"""Atomic writing of files, and its errors."""

from __future__ import annotations

import os
from pathlib import Path
from stat import S_ISDIR

import pytest

from cell.support.files.whole_file import write_whole
from robots.errors import StorageError


def test_an_error_after_the_rename_is_raised_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder cannot be synced, as on some network drives, or an interrupt comes at that moment."""

    def fails(error: BaseException) -> None:
        def sync(handle: int) -> None:
            if S_ISDIR(os.fstat(handle).st_mode):
                raise error

        monkeypatch.setattr(os, "fsync", sync)

    fails(OSError(22, "Invalid argument"))
    with pytest.raises(StorageError, match="Invalid argument"):
        write_whole(tmp_path / "file", "text")
    fails(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "file", "text")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
