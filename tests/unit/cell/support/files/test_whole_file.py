"""Atomic writing of files, and its errors."""

from __future__ import annotations

import os
import resource
from pathlib import Path
from stat import S_ISDIR
from typing import Any

import pytest

from foldcell.cell.support.files.whole_file import PROBE_BYTES, refuse_unwritable, write_whole
from foldcell.robots.errors import StorageError


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


def test_a_file_that_cannot_be_written_is_found_before_its_content_is_computed(
    tmp_path: Path, lockable: Any
) -> None:
    with lockable.read_only(), pytest.raises(StorageError, match="Permission denied"):
        refuse_unwritable(lockable.folder / "file")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (PROBE_BYTES // 2, hard))  # as a disk without space
    try:
        with pytest.raises(StorageError, match="cannot be written"):
            refuse_unwritable(tmp_path / "file")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    refuse_unwritable(tmp_path / "file")
    assert not [*tmp_path.iterdir(), *lockable.folder.iterdir()]
